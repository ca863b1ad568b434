//! The triangles of a glTF 2.0 file (ISO/IEC 12113), as text or as GLB. Looks, skins and animations are left aside.

use super::surface::Triangle;
use super::{MAX_TRIANGLES, SIZE_LIMIT};
use base64::Engine;
use glamx::{Mat4, Quat, Vec3};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
struct Document {
    asset: Object,
    extensions_required: Vec<String>,
    scene: usize,
    scenes: Vec<Object>,
    nodes: Vec<Object>,
    meshes: Vec<Object>,
    accessors: Vec<Object>,
    buffer_views: Vec<Object>,
    buffers: Vec<Object>,
}

/// Any object of a document, with what is read of all kinds of them.
#[derive(Deserialize, Default)]
#[serde(rename_all = "camelCase", default)]
struct Object {
    version: String,
    nodes: Vec<usize>,
    children: Vec<usize>,
    mesh: Option<usize>,
    matrix: Option<[f32; 16]>,
    translation: [f32; 3],
    rotation: Option<[f32; 4]>,
    scale: Option<[f32; 3]>,
    primitives: Vec<Object>,
    attributes: BTreeMap<String, usize>,
    indices: Option<usize>,
    mode: Option<u32>,
    buffer_view: Option<usize>,
    buffer: usize,
    byte_offset: usize,
    byte_length: usize,
    byte_stride: Option<usize>,
    component_type: u32,
    count: usize,
    r#type: String,
    sparse: Option<serde::de::IgnoredAny>,
    extensions: BTreeMap<String, serde::de::IgnoredAny>,
    uri: Option<String>,
}

/// Extensions that begin so change how a surface looks, not where it is.
const LOOKS: [&str; 4] = ["KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_"];
/// Many copies of a mesh; a file need not require it.
const INSTANCES: &str = "EXT_mesh_gpu_instancing";

/// A file's triangles where its nodes put them, y up.
pub(super) fn triangles(content: &[u8], path: &Path) -> Result<Vec<Triangle>, String> {
    let (text, binary) = parts(content)?;
    let file: Document = serde_json::from_slice(text).map_err(|e| e.to_string())?;
    if !file.asset.version.starts_with("2.") {
        return Err(format!("it is of glTF {}: export it as 2.0", file.asset.version));
    }
    let beyond_looks = |name: &&String| !LOOKS.iter().any(|begin| name.starts_with(begin));
    if let Some(extension) = file.extensions_required.iter().find(beyond_looks) {
        return Err(format!("it requires {extension}: export it without, uncompressed"));
    }
    let buffers = buffers(&file, binary, path)?;
    let scene = of(&file.scenes, file.scene, "scene")?;
    let mut open: Vec<(usize, Mat4)> = scene.nodes.iter().map(|node| (*node, Mat4::IDENTITY)).collect();
    let mut was_met = vec![false; file.nodes.len()];
    let mut all = Vec::new();
    while let Some((number, above)) = open.pop() {
        let node = of(&file.nodes, number, "node")?;
        if core::mem::replace(&mut was_met[number], true) {
            return Err(format!("node {number} is its own descendant, or has two parents"));
        }
        let turn = Quat::from_array(node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0])).normalize();
        let [scale, shift] = [node.scale.unwrap_or([1.0; 3]), node.translation].map(Vec3::from);
        let placed = Mat4::from_scale_rotation_translation(scale, turn, shift);
        let here = above * node.matrix.map_or(placed, |matrix| Mat4::from_cols_array(&matrix));
        if let Some(mesh) = node.mesh {
            if node.extensions.contains_key(INSTANCES) {
                return Err(format!("node {number} is instanced by {INSTANCES}: export it without"));
            }
            for primitive in &of(&file.meshes, mesh, "mesh")?.primitives {
                add(&file, &buffers, primitive, &here, &mut all)?;
            }
        }
        open.extend(node.children.iter().map(|child| (*child, here)));
    }
    Ok(all)
}

/// What a number stands for.
fn of<'a, T>(list: &'a [T], number: usize, what: &str) -> Result<&'a T, String> {
    list.get(number)
        .ok_or_else(|| format!("{what} {number} is not in the file"))
}

/// The text, and the binary part that a GLB may have.
fn parts(content: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    let Some(header) = content.strip_prefix(b"glTF") else {
        return Ok((content, None));
    };
    let Some((&[2, 0, 0, 0, ..], mut rest)) = header.split_first_chunk::<8>() else {
        return Err("it is no GLB of version 2".to_owned());
    };
    let (mut text, mut binary) = (None, None);
    while let Some((&[a, b, c, d, kind @ ..], after)) = rest.split_first_chunk::<8>() {
        let length = u32::from_le_bytes([a, b, c, d]) as usize;
        let (part, after) = after.split_at_checked(length).ok_or("it is cut short")?;
        match &kind {
            b"JSON" => text = text.or(Some(part)),
            b"BIN\0" => binary = binary.or(Some(part)),
            _ => {}
        }
        rest = after;
    }
    Ok((text.ok_or("its JSON part is missing")?, binary))
}

/// The content of each buffer, at least as long as it says: the binary part, within the text, or in a file beside this one.
fn buffers(file: &Document, binary: Option<&[u8]>, path: &Path) -> Result<Vec<Vec<u8>>, String> {
    let mut left = SIZE_LIMIT;
    let mut all = Vec::new();
    for (number, buffer) in file.buffers.iter().enumerate() {
        let bytes = match (&buffer.uri, binary) {
            (Some(uri), _) => of_uri(uri, path, left)?,
            (None, Some(binary)) if number == 0 => binary.to_vec(),
            _ => return Err(format!("the data of buffer {number} are missing")),
        };
        if bytes.len() < buffer.byte_length {
            let (has, says) = (bytes.len(), buffer.byte_length);
            return Err(format!("buffer {number} has {has} of {says} bytes"));
        }
        left = left.saturating_sub(bytes.len() as u64);
        all.push(bytes);
    }
    Ok(all)
}

fn of_uri(uri: &str, path: &Path, limit: u64) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let text = data.split_once(";base64,").map(|(_, text)| text);
        let decoded = text.and_then(|text| base64::engine::general_purpose::STANDARD.decode(text).ok());
        return decoded.ok_or_else(|| "its data within are not base64".to_owned());
    }
    let beside = path.with_file_name(file_name(uri));
    vigil_types::files::read(&beside, limit).map_err(|e| format!("its {uri} beside it cannot be read: {e}"))
}

/// A URI as a name: `%` and two hexadecimal digits are a byte.
fn file_name(uri: &str) -> String {
    let (mut bytes, mut rest) = (Vec::new(), uri.as_bytes());
    while let Some((first, after)) = rest.split_first() {
        let digit = |at: usize| after.get(at).and_then(|digit| char::from(*digit).to_digit(16));
        let (byte, left) = match (*first, digit(0), digit(1)) {
            (b'%', Some(high), Some(low)) => ((high << 4 | low) as u8, &after[2..]),
            _ => (*first, after),
        };
        bytes.push(byte);
        rest = left;
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// What an accessor reaches: elements, so many bytes from one to the next.
struct Elements<'a> {
    bytes: &'a [u8],
    count: usize,
    stride: usize,
    size: usize,
}

impl<'a> Elements<'a> {
    /// `sizes` has the types of components that are meant, as numbered there, with the bytes of an element of each.
    fn new(
        (file, buffers): (&Document, &'a [Vec<u8>]),
        number: usize,
        shape: &str,
        sizes: &[(u32, usize)],
    ) -> Result<Self, String> {
        let accessor = of(&file.accessors, number, "accessor")?;
        let kind = accessor.component_type;
        let size = sizes
            .iter()
            .find(|(known, _)| *known == kind && accessor.r#type == shape);
        let Some((_, size)) = size.filter(|_| accessor.sparse.is_none()) else {
            let (sparse, has) = (if accessor.sparse.is_some() { "sparse " } else { "" }, &accessor.r#type);
            return Err(format!(
                "accessor {number} has {sparse}{has} of type {kind}, which is not read there"
            ));
        };
        let view = accessor.buffer_view.and_then(|view| file.buffer_views.get(view));
        let view = view.ok_or_else(|| format!("the data of accessor {number} are missing"))?;
        let stride = view.byte_stride.unwrap_or(*size);
        let within = || {
            let bytes = buffers.get(view.buffer)?.get(view.byte_offset..)?;
            let bytes = bytes.get(..view.byte_length)?.get(accessor.byte_offset..)?;
            let last = accessor.count.checked_sub(1)?.checked_mul(stride)?;
            (last.checked_add(*size)? <= bytes.len() && stride >= *size).then_some(bytes)
        };
        Ok(Self {
            bytes: within().ok_or_else(|| format!("accessor {number} reaches beyond its data"))?,
            count: accessor.count,
            stride,
            size: *size,
        })
    }

    /// The bytes of an element; none beyond the last.
    fn get(&self, number: usize) -> Option<&[u8]> {
        let at = (number < self.count).then_some(number * self.stride)?;
        self.bytes.get(at..at + self.size)
    }
}

/// Adds a primitive's triangles; points and lines have none.
fn add(
    file: &Document,
    buffers: &[Vec<u8>],
    primitive: &Object,
    here: &Mat4,
    all: &mut Vec<Triangle>,
) -> Result<(), String> {
    // Of a strip or a fan, each corner from the third on ends a triangle.
    let (apart, fan) = match primitive.mode {
        None | Some(4) => (3, false),
        Some(5) => (1, false),
        Some(6) => (1, true),
        Some(_) => return Ok(()),
    };
    let position = *primitive.attributes.get("POSITION").ok_or("a mesh has no positions")?;
    let positions = Elements::new((file, buffers), position, "VEC3", &[(5126, 12)])?;
    let sizes = [(5121, 1), (5123, 2), (5125, 4)];
    let indices = primitive
        .indices
        .map(|number| Elements::new((file, buffers), number, "SCALAR", &sizes));
    let indices = indices.transpose()?;
    let count = indices.as_ref().map_or(positions.count, |indices| indices.count);
    if all.len() + count / apart > MAX_TRIANGLES {
        return Err(format!("it has more than {MAX_TRIANGLES} triangles: simplify it"));
    }
    let corner = |n: usize| {
        let index = |bytes: &[u8]| bytes.iter().rev().fold(0, |all, byte| all << 8 | usize::from(*byte));
        let number = indices.as_ref().map_or(Some(n), |indices| indices.get(n).map(index))?;
        let (words, _) = positions.get(number)?.as_chunks::<4>();
        let place = Vec3::from_array(core::array::from_fn(|k| f32::from_le_bytes(words[k])));
        Some(here.transform_point3(place).to_array())
    };
    for n in (2..count).step_by(apart) {
        let first = if fan { 0 } else { n - 2 };
        let (Some(a), Some(b), Some(c)) = (corner(first), corner(n - 1), corner(n)) else {
            return Err(format!("a face has a corner that accessor {position} does not have"));
        };
        all.push([a, b, c]);
    }
    Ok(())
}
