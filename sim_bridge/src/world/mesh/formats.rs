//! The triangles of a file, in its own axes and unit.

use super::surface::Triangle;
use super::{Up, gltf};
use std::io::Cursor;
use std::path::Path;

/// A file's triangles and the axis that points up by its format.
pub(super) fn triangles(path: &Path, content: &[u8]) -> Result<(Vec<Triangle>, Up), String> {
    let ending = path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default()
        .to_lowercase();
    let (found, up) = match ending.as_str() {
        "obj" => (of_obj(content), Up::Z),
        "stl" => (of_stl(content), Up::Z),
        "gltf" | "glb" => (gltf::triangles(content, path), Up::Y),
        _ => return Err("is no mesh by its name; one that is read ends in .obj, .stl, .gltf or .glb".to_owned()),
    };
    match found {
        Ok(found) if found.is_empty() => Err("has no triangles; export its faces too".to_owned()),
        Ok(found) => Ok((found, up)),
        Err(why) => Err(format!("is not a mesh that can be read ({why}); export it again")),
    }
}

/// Corners by their numbers.
fn indexed(numbers: impl Iterator<Item = usize>, corner: impl Fn(usize) -> Option<[f32; 3]>) -> Option<Vec<Triangle>> {
    let corners: Vec<[f32; 3]> = numbers.map(corner).collect::<Option<_>>()?;
    Some(corners.as_chunks().0.to_vec())
}

fn of_obj(content: &[u8]) -> Result<Vec<Triangle>, String> {
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
        ..tobj::LoadOptions::default()
    };
    // Materials are not seen.
    let (models, _) = tobj::load_obj_buf(&mut Cursor::new(content), &options, |_| Ok(Default::default()))
        .map_err(|e| e.to_string())?;
    let mut all = Vec::new();
    for mesh in models.iter().map(|model| &model.mesh) {
        let corner = |n: usize| mesh.positions.as_chunks().0.get(n).copied();
        let numbers = mesh.indices.iter().map(|n| *n as usize);
        all.extend(indexed(numbers, corner).ok_or("a face has a corner that is not in the file")?);
    }
    Ok(all)
}

fn of_stl(content: &[u8]) -> Result<Vec<Triangle>, String> {
    let mut content = Cursor::new(content);
    let triangles = stl_io::create_stl_reader(&mut content).map_err(|e| e.to_string())?;
    triangles
        .map(|t| t.map(|t| t.vertices.map(|v| v.0)).map_err(|e| e.to_string()))
        .collect()
}
