use super::accessor::Attribute;
use super::json::{Node, Primitive, Root};
use super::{BINARY_CHUNK, EXTENSION, JSON_CHUNK, MAGIC, VERSION, attribute, sh_attribute};
use crate::error::Fault;
use crate::file::{Decoded, Remark};
use crate::numbers::{gaussians, log_size, logit};
use crate::turn::{Flip, Similarity};
use crate::{Quantity, Rule};
use glam::{DMat3, DMat4, DQuat, DVec3};
use gs_scene::{Gaussians, sh_coefficients};
use std::io::{BufRead, Read};

/// Longest JSON, bytes. A scene of Gaussians has some 10 KiB.
const JSON_LIMIT: u32 = 16 << 20;
/// Extensions that a file may require of a reader.
const KNOWN: [&str; 2] = [EXTENSION, "KHR_mesh_quantization"];
/// Most bytes of Gaussians that a byte of the file may become: attributes may share data, and nodes meshes.
const MOST_EXPANSION: u64 = 16;
/// Up to here the ratio is not looked at, bytes.
const FREE: u64 = 64 << 20;

/// Reads exactly so many bytes; memory grows with what is there.
fn bytes(reader: &mut impl Read, length: u32, what: &'static str) -> Result<Vec<u8>, Fault> {
    let mut bytes = Vec::new();
    reader.take(length.into()).read_to_end(&mut bytes)?;
    if bytes.len() < length as usize {
        let (promised, found) = (length.into(), bytes.len() as u64);
        return Err(Rule::Truncated { what, promised, found }.into());
    }
    Ok(bytes)
}

fn words<const N: usize>(reader: &mut impl Read) -> Result<[u32; N], Fault> {
    let mut words = [0; N];
    for word in &mut words {
        let mut bytes = [0; 4];
        reader.read_exact(&mut bytes).map_err(|error| match error.kind() {
            std::io::ErrorKind::UnexpectedEof => Fault::Rule(Rule::Header),
            _ => Fault::Io(error),
        })?;
        *word = u32::from_le_bytes(bytes);
    }
    Ok(words)
}

pub(crate) fn decode(reader: &mut impl BufRead) -> Decoded {
    let [magic, version, length] = words(reader)?;
    if magic.to_le_bytes() != MAGIC {
        return Err(Rule::Magic.into());
    }
    if version != VERSION {
        return Err(Rule::Version { found: version, expected: "2" }.into());
    }
    let mut reader = reader.take(u64::from(length).saturating_sub(12));
    let [json_length, kind] = words(&mut reader)?;
    if kind != JSON_CHUNK {
        return Err(Rule::Unsupported { what: "first chunk", found: format!("{kind:#010x}") }.into());
    }
    if json_length > JSON_LIMIT {
        let expected = "at most 16777216";
        return Err(Rule::Field { what: "length of the JSON", found: json_length.into(), expected }.into());
    }
    let json = bytes(&mut reader, json_length, "bytes of JSON")?;
    let root: Root =
        serde_json::from_slice(&json).map_err(|error| Rule::Json { reason: error.to_string() })?;
    drop(json);
    if !root.asset.version.starts_with("2.") {
        return Err(Rule::Unsupported { what: "asset version", found: root.asset.version }.into());
    }
    if let Some(found) = root.extensions_required.iter().find(|name| !KNOWN.contains(&name.as_str())) {
        return Err(Rule::Unsupported { what: "required extension", found: found.clone() }.into());
    }
    let [binary_length, kind] = words(&mut reader)?;
    if kind != BINARY_CHUNK {
        return Err(Rule::Unsupported { what: "second chunk", found: format!("{kind:#010x}") }.into());
    }
    let binary = bytes(&mut reader, binary_length, "bytes of data")?;
    collect(&root, &binary)
}

/// The Gaussians of all nodes of the scene.
fn collect(root: &Root, binary: &[u8]) -> Decoded {
    let (mut parts, mut others) = (Vec::new(), 0);
    let mut budget = FREE.max(binary.len() as u64 * MOST_EXPANSION);
    for (node, matrix) in placed(root)? {
        let Some(index) = root.nodes[node].mesh else { continue };
        let mesh = root.meshes.get(index).ok_or(Rule::Index { what: "mesh", index })?;
        for primitive in &mesh.primitives {
            if primitive.extensions.splatting.is_none() {
                others += 1;
                continue;
            }
            let mut part = read_primitive(root, binary, primitive, &mut budget)?;
            if matrix != DMat4::IDENTITY {
                similarity(node, matrix)?.apply(&mut part);
            }
            Flip::gltf().apply(&mut part);
            parts.push(part);
        }
    }
    let degree = parts.iter().map(Gaussians::sh_degree).max().ok_or(Rule::Empty)?;
    let mut parts =
        parts.into_iter().map(|part| part.with_sh_degree(degree).expect("a degree that another part has"));
    let mut all = parts.next().ok_or(Rule::Empty)?;
    parts.for_each(|part| all.append(&part));
    let remarks = if others > 0 { vec![Remark::Primitives { count: others }] } else { Vec::new() };
    Ok((all, remarks))
}

/// The nodes of the scene with their places in it; without scenes all nodes that are no child of another.
fn placed(root: &Root) -> Result<Vec<(usize, DMat4)>, Rule> {
    let index = root.scene.unwrap_or(0);
    let starts = match root.scenes.get(index) {
        Some(scene) => scene.nodes.clone(),
        None if root.scenes.is_empty() => {
            let mut is_child = vec![false; root.nodes.len()];
            for &child in root.nodes.iter().flat_map(|node| &node.children) {
                *is_child.get_mut(child).ok_or(Rule::Index { what: "node", index: child })? = true;
            }
            (0..root.nodes.len()).filter(|&node| !is_child[node]).collect()
        }
        None => return Err(Rule::Index { what: "scene", index }),
    };
    let mut seen = vec![false; root.nodes.len()];
    let mut found = Vec::new();
    let mut open: Vec<_> = starts.into_iter().rev().map(|node| (node, DMat4::IDENTITY)).collect();
    while let Some((index, parent)) = open.pop() {
        // A tree has no node twice; this also ends circles.
        match seen.get_mut(index) {
            Some(seen @ false) => *seen = true,
            _ => return Err(Rule::Index { what: "node", index }),
        }
        let node = &root.nodes[index];
        let matrix = parent * local(node);
        found.push((index, matrix));
        open.extend(node.children.iter().rev().map(|&child| (child, matrix)));
    }
    Ok(found)
}

fn local(node: &Node) -> DMat4 {
    if let Some(matrix) = &node.matrix {
        return DMat4::from_cols_array(matrix);
    }
    DMat4::from_scale_rotation_translation(
        node.scale.map_or(DVec3::ONE, DVec3::from),
        node.rotation.map_or(DQuat::IDENTITY, DQuat::from_array),
        node.translation.map_or(DVec3::ZERO, DVec3::from),
    )
}

/// The matrix as a rotation, one scale and a translation.
fn similarity(node: usize, matrix: DMat4) -> Result<Similarity, Rule> {
    /// Rounding of a file's numbers.
    const TOLERANCE: f64 = 1e-4;
    let linear = DMat3::from_mat4(matrix);
    let scale = linear.determinant().cbrt();
    let rotation = linear * (1.0 / scale);
    let deviation = rotation * rotation.transpose() - DMat3::IDENTITY;
    let is_similar = scale > 0.0 && deviation.to_cols_array().iter().all(|value| value.abs() <= TOLERANCE);
    let translation = matrix.w_axis.truncate();
    if !is_similar || !translation.is_finite() {
        return Err(Rule::Transform { node });
    }
    Ok(Similarity { rotation: DQuat::from_mat3(&rotation).normalize(), scale, translation })
}

fn read_primitive(
    root: &Root,
    binary: &[u8],
    primitive: &Primitive,
    budget: &mut u64,
) -> Result<Gaussians, Rule> {
    let unsupported = |what, found: &str| Err(Rule::Unsupported { what, found: found.into() });
    if let Some(splatting) = &primitive.extensions.splatting {
        if let Some(name) = splatting.extensions.keys().next() {
            return unsupported("extension", name);
        }
        if splatting.kernel != "ellipse" {
            return unsupported("kernel", &splatting.kernel);
        }
        if splatting.color_space != "srgb_rec709_display" {
            return unsupported("colour space", &splatting.color_space);
        }
    }
    // Triangles (4) are glTF's default.
    if primitive.mode != Some(0) {
        return unsupported("mode of a primitive of Gaussians", &primitive.mode.unwrap_or(4).to_string());
    }
    let has = |name: &str| primitive.attributes.contains_key(name);
    let get = |name: String, kind| {
        let index = primitive.attributes.get(&name).copied();
        Attribute::new(
            root,
            binary,
            &name,
            index.ok_or_else(|| Rule::Attribute { name: name.clone() })?,
            kind,
        )
    };
    let position = get("POSITION".into(), ("VEC3", 3))?;
    let rotation = get(attribute("ROTATION"), ("VEC4", 4))?;
    let scale = get(attribute("SCALE"), ("VEC3", 3))?;
    let opacity = get(attribute("OPACITY"), ("SCALAR", 1))?;
    let degree = (1..=3).rev().find(|&degree| {
        (sh_coefficients(degree - 1)..sh_coefficients(degree))
            .any(|coefficient| has(&sh_attribute(coefficient)))
    });
    let degree = degree.unwrap_or(0);
    let sh = (0..sh_coefficients(degree)).map(|coefficient| get(sh_attribute(coefficient), ("VEC3", 3)));
    let sh: Vec<Attribute> = sh.collect::<Result<_, _>>()?;

    let count = position.count;
    let attributes = [&rotation, &scale, &opacity].into_iter().chain(&sh);
    if let Some(other) = attributes.into_iter().find(|attribute| attribute.count != count) {
        let (found, expected) = (other.count as u64, count as u64);
        return Err(Rule::Length { what: "number of Gaussians in an attribute", found, expected });
    }
    let needed = count as u64 * 4 * (Gaussians::GEOMETRY + 3 * sh.len()) as u64;
    *budget = budget.checked_sub(needed).ok_or(Rule::Expansion { most: MOST_EXPANSION })?;
    let (mut geometry, mut all_sh) = (Vec::new(), Vec::new());
    for gaussian in 0..count {
        geometry.extend(position.get::<3>(gaussian));
        let [x, y, z, w] = rotation.get(gaussian);
        geometry.extend([w, x, y, z]);
        let sizes: [f32; 3] = scale.get(gaussian);
        let [share] = opacity.get(gaussian);
        let wrong = |quantity, found: f32, expected| {
            Err(Rule::Value { gaussian, quantity, found: found.into(), expected })
        };
        if let Some(&size) = sizes.iter().find(|&&size| !(size >= 0.0 && size.is_finite())) {
            return wrong(Quantity::Size, size, "a finite number of at least 0");
        }
        if !(0.0..=1.0).contains(&share) {
            return wrong(Quantity::Opacity, share, "0 to 1");
        }
        geometry.extend(sizes.map(log_size));
        geometry.push(logit(share));
        sh.iter().for_each(|attribute| all_sh.extend(attribute.get::<3>(gaussian)));
    }
    Ok(gaussians(degree, geometry, all_sh))
}
