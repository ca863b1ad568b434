//! The triangles of a file, in its own axes and unit.

use super::surface::Triangle;
use super::{Up, gltf};
use glamx::Vec3;
use std::io::Cursor;
use std::path::Path;

/// A file's triangles and the axis that points up by its format.
pub(super) fn triangles(path: &Path, content: &[u8]) -> Result<(Vec<Triangle>, Up), String> {
    let ending = path
        .extension()
        .and_then(|e| e.to_str())
        .unwrap_or_default()
        .to_lowercase();
    // Text may begin with a byte-order mark; what has a byte of 0 is no text.
    let text = content.strip_prefix(b"\xef\xbb\xbf").filter(|text| !text.contains(&0));
    let content = text.unwrap_or(content);
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

/// The sine of the turn to the other side that a convex face may have at a corner, for rounding.
const STRAIGHT: f32 = 1e-3;

/// Whether a face turns to one side at all of its corners, so that a fan from the first covers it and nothing else.
fn is_convex(corners: &[[f32; 3]]) -> bool {
    // What is no number is refused later, with its triangle.
    if corners.iter().flatten().any(|x| !x.is_finite()) {
        return true;
    }
    let points: Vec<Vec3> = corners.iter().map(|p| Vec3::from(*p)).collect();
    let areas = points
        .windows(2)
        .map(|edge| (edge[0] - points[0]).cross(edge[1] - points[0]));
    let side = areas.sum::<Vec3>().normalize_or_zero();
    let edges = points
        .iter()
        .zip(points.iter().cycle().skip(1))
        .map(|(from, to)| *to - *from);
    // A corner that is given twice turns nowhere.
    let ways: Vec<Vec3> = edges
        .map(Vec3::normalize_or_zero)
        .filter(|way| *way != Vec3::ZERO)
        .collect();
    let mut turns = ways
        .iter()
        .zip(ways.iter().cycle().skip(1))
        .map(|(way, next)| way.cross(*next));
    // Without an area it is a line, or two parts that cancel each other.
    turns.all(|turn| match side == Vec3::ZERO {
        true => turn.length() < STRAIGHT,
        false => turn.dot(side) > -STRAIGHT,
    })
}

/// The corners and faces of a text as tobj reads them: without comments, each on one line, and of a face's corners the places alone.
fn faces(text: &str) -> String {
    let (mut faces, mut goes_on) = (String::new(), None);
    for line in text.lines() {
        let line = line.split('#').next().unwrap_or_default().trim();
        // Names, materials and textures are not seen; a line of several points would be taken for a face.
        let kind = goes_on.or_else(|| line.split_whitespace().next());
        if matches!(kind, Some("v" | "f")) {
            let begun = line.strip_suffix('\\');
            for word in begun.unwrap_or(line).split_whitespace() {
                let place = word
                    .split('/')
                    .next()
                    .filter(|place| kind == Some("f") && !place.is_empty());
                faces += place.unwrap_or(word);
                faces.push(' ');
            }
            goes_on = begun.and(kind);
            faces += if goes_on.is_some() { "" } else { "\n" };
        }
    }
    faces
}

fn of_obj(content: &[u8]) -> Result<Vec<Triangle>, String> {
    let options = tobj::LoadOptions {
        ignore_points: true,
        ignore_lines: true,
        ..tobj::LoadOptions::default()
    };
    // Names and comments are often not UTF-8.
    let text = faces(&String::from_utf8_lossy(content));
    let (models, _) =
        tobj::load_obj_buf(&mut text.as_bytes(), &options, |_| Ok(Default::default())).map_err(|e| e.to_string())?;
    let mut all = Vec::new();
    for mesh in models.iter().map(|model| &model.mesh) {
        let places = mesh.positions.as_chunks::<3>().0;
        let corners = mesh.indices.iter().map(|n| places.get(*n as usize).copied());
        let corners: Vec<[f32; 3]> = corners
            .collect::<Option<_>>()
            .ok_or("a face has a corner that is not in the file")?;
        let mut rest = corners.as_slice();
        // Of a mesh of triangles alone there are no counts.
        let mut counts = mesh.face_arities.iter().map(|count| *count as usize);
        while !rest.is_empty() {
            let count = counts.next().unwrap_or(3);
            let (face, after) = rest.split_at_checked(count).ok_or("a face has too few corners")?;
            if count > 3 && !is_convex(face) {
                return Err(format!(
                    "it has a face of {count} corners that is not convex: triangulate its faces"
                ));
            }
            if let [first, others @ ..] = face {
                all.extend(others.windows(2).map(|edge| [*first, edge[0], edge[1]]));
            }
            rest = after;
        }
    }
    Ok(all)
}

/// The solids of a text file as one, in lower case, as stl_io reads it; `None` of a binary file, which may begin with the same word, but
/// whose number of triangles has a byte of 0.
fn one_solid(content: &[u8]) -> Result<Option<String>, String> {
    if content.contains(&0) {
        return Ok(None);
    }
    let text = String::from_utf8_lossy(content);
    let first_is = |line: &str, word: &str| {
        let first = line.split_whitespace().next();
        first.is_some_and(|first| first.eq_ignore_ascii_case(word))
    };
    if !first_is(&text, "solid") {
        return Ok(None);
    }
    let last = text.lines().rfind(|line| !line.trim().is_empty());
    if !last.is_some_and(|last| first_is(last, "endsolid")) {
        return Err("it is cut off".to_owned());
    }
    let mut one = "solid all\n".to_owned();
    let begins_or_ends = |line: &&str| first_is(line, "solid") || first_is(line, "endsolid");
    for line in text.lines().filter(|line| !begins_or_ends(line)) {
        // The normal of a face without an area is often no number; none is used.
        match first_is(line, "facet") {
            true => one += "facet normal 0 0 0",
            false => one += &line.to_ascii_lowercase(),
        }
        one.push('\n');
    }
    Ok(Some(one + "endsolid all\n"))
}

fn of_stl(content: &[u8]) -> Result<Vec<Triangle>, String> {
    let one = one_solid(content)?;
    let mut content = Cursor::new(one.as_ref().map_or(content, |text| text.as_bytes()));
    let triangles = stl_io::create_stl_reader(&mut content).map_err(|e| e.to_string())?;
    triangles
        .map(|t| t.map(|t| t.vertices.map(|v| v.0)).map_err(|e| e.to_string()))
        .collect()
}
