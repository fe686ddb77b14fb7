use super::json::{
    Accessor, Asset, Buffer, BufferView, Extensions, Mesh, Node, Primitive, Root, Scene, Splatting,
};
use super::{
    BINARY_CHUNK, EXTENSION, FLOAT, JSON_CHUNK, MAGIC, UNSIGNED_BYTE, VERSION, attribute, sh_attribute,
};
use crate::numbers::{Row, byte, colour, rows};
use crate::turn::Flip;
use crate::{Loss, Quantity, Rule};
use gs_scene::{Gaussians, OPACITY_LOGIT, sh_coefficients};
use std::io::Write;

/// Bytes of the two headers of chunks and of the file.
const HEADERS: u64 = 12 + 8 + 8;
/// What a buffer view of vertices is for.
const ARRAY_BUFFER: u32 = 34962;
/// Bytes of JSON that are reserved when the size of a file is estimated; a real one has some 10 KiB.
const JSON_ROOM: u64 = 1 << 16;

/// An attribute of the primitive.
enum Column {
    Position,
    /// The colour of a point, for viewers that know no Gaussians.
    Fallback,
    Rotation,
    Scale,
    Opacity,
    Sh(usize),
}

impl Column {
    fn all(degree: usize) -> impl Iterator<Item = Self> {
        let sh = (0..sh_coefficients(degree)).map(Self::Sh);
        [Self::Position, Self::Fallback, Self::Rotation, Self::Scale, Self::Opacity].into_iter().chain(sh)
    }

    fn name(&self) -> String {
        match self {
            Self::Position => "POSITION".into(),
            Self::Fallback => "COLOR_0".into(),
            Self::Rotation => attribute("ROTATION"),
            Self::Scale => attribute("SCALE"),
            Self::Opacity => attribute("OPACITY"),
            Self::Sh(coefficient) => sh_attribute(*coefficient),
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Fallback | Self::Rotation => "VEC4",
            Self::Opacity => "SCALAR",
            Self::Position | Self::Scale | Self::Sh(_) => "VEC3",
        }
    }

    /// Bytes of a Gaussian.
    fn width(&self) -> u64 {
        match self {
            Self::Fallback | Self::Opacity => 4,
            Self::Rotation => 16,
            Self::Position | Self::Scale | Self::Sh(_) => 12,
        }
    }

    fn put(&self, row: &Row, flip: &Flip, out: &mut Vec<u8>) {
        let mut floats = |values: &[f32]| values.iter().for_each(|value| out.extend(value.to_le_bytes()));
        match self {
            Self::Position => floats(&flip.mean(row.mean)),
            Self::Fallback => {
                out.extend((0..3).map(|i| byte(linear(colour(row.sh[i])))));
                out.push(byte(row.opacity.into()));
            }
            Self::Rotation => {
                let [w, x, y, z] = flip.quaternion(row.quaternion);
                floats(&[x, y, z, w].map(|value| value as f32));
            }
            Self::Scale => floats(&row.log_scale.map(f32::exp)),
            Self::Opacity => floats(&[row.opacity]),
            Self::Sh(k) => floats(&std::array::from_fn::<_, 3, _>(|i| flip.sh(*k) * row.sh[3 * k + i])),
        }
    }
}

/// An sRGB value as linear light.
fn linear(value: f64) -> f64 {
    let value = value.clamp(0.0, 1.0);
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// Bytes of the binary part.
fn binary_length(gaussians: &Gaussians) -> u64 {
    Column::all(gaussians.sh_degree()).map(|column| column.width() * gaussians.len() as u64).sum()
}

pub(crate) fn losses(gaussians: &Gaussians) -> Result<Vec<Loss>, Rule> {
    let bytes = binary_length(gaussians) + HEADERS + JSON_ROOM;
    if bytes > u32::MAX.into() {
        return Err(Rule::Field { what: "length in bytes", found: bytes, expected: "at most 4294967295" });
    }
    let rounding = f64::from(f32::EPSILON);
    let rounded = |quantity, unit| Loss::Rounded { quantity, bits: 32, error: rounding, unit };
    let mut losses = vec![
        rounded(Quantity::Size, "of itself, as it is stored activated"),
        rounded(Quantity::Opacity, "of opaque, as it is stored activated"),
        rounded(Quantity::Rotation, "in a component of the quaternion, which is normalised"),
    ];
    // Beyond, the logit is not found again.
    let mut logit = crate::loss::Clipping::new(Quantity::Opacity, [-87.0, 16.6]);
    let logits = gaussians.geometry().chunks_exact(Gaussians::GEOMETRY).map(|row| row[OPACITY_LOGIT]);
    logits.for_each(|value| logit.count([f64::from(value)]));
    losses.extend(logit.loss(gaussians.len()).map(|loss| match loss {
        Loss::Clipped { quantity, gaussians, of: total, .. } => {
            Loss::Saturated { quantity, gaussians, of: total }
        }
        other => other,
    }));
    Ok(losses)
}

pub(crate) fn encode(gaussians: &Gaussians, out: &mut dyn Write) -> std::io::Result<()> {
    let (count, flip) = (gaussians.len() as u64, Flip::gltf());
    let mut root = Root {
        asset: Asset { version: "2.0".into(), generator: Some("sparsesplat".into()) },
        extensions_used: vec![EXTENSION.into()],
        scene: Some(0),
        scenes: vec![Scene { nodes: vec![0] }],
        nodes: vec![Node { mesh: Some(0), ..Node::default() }],
        buffers: vec![Buffer { byte_length: binary_length(gaussians), uri: None }],
        ..Root::default()
    };
    let splatting = Splatting {
        kernel: "ellipse".into(),
        color_space: "srgb_rec709_display".into(),
        extensions: Default::default(),
    };
    let extensions = Extensions { splatting: Some(splatting) };
    let mut primitive = Primitive { mode: Some(0), extensions, ..Primitive::default() };
    let mut offset = 0;
    for (index, column) in Column::all(gaussians.sh_degree()).enumerate() {
        let is_fallback = matches!(column, Column::Fallback);
        let (min, max) =
            if matches!(column, Column::Position) { bounds(gaussians, &flip) } else { Default::default() };
        root.accessors.push(Accessor {
            buffer_view: Some(index),
            component_type: if is_fallback { UNSIGNED_BYTE } else { FLOAT },
            normalized: is_fallback,
            count,
            kind: column.kind().into(),
            min,
            max,
            ..Accessor::default()
        });
        let byte_length = column.width() * count;
        let target = Some(ARRAY_BUFFER);
        root.buffer_views.push(BufferView {
            byte_offset: offset,
            byte_length,
            target,
            ..BufferView::default()
        });
        primitive.attributes.insert(column.name(), index);
        offset += byte_length;
    }
    root.meshes.push(Mesh { primitives: vec![primitive] });

    let mut json = serde_json::to_vec(&root)?;
    json.resize(json.len().next_multiple_of(4), b' ');
    let length = |bytes: u64| u32::try_from(bytes).map_err(std::io::Error::other);
    out.write_all(&MAGIC)?;
    out.write_all(&VERSION.to_le_bytes())?;
    out.write_all(&length(HEADERS + json.len() as u64 + offset)?.to_le_bytes())?;
    out.write_all(&length(json.len() as u64)?.to_le_bytes())?;
    out.write_all(&JSON_CHUNK.to_le_bytes())?;
    out.write_all(&json)?;
    out.write_all(&length(offset)?.to_le_bytes())?;
    out.write_all(&BINARY_CHUNK.to_le_bytes())?;
    let mut bytes = Vec::new();
    for column in Column::all(gaussians.sh_degree()) {
        for row in rows(gaussians) {
            bytes.clear();
            column.put(&row, &flip, &mut bytes);
            out.write_all(&bytes)?;
        }
    }
    Ok(())
}

/// Smallest and largest position, which glTF demands.
fn bounds(gaussians: &Gaussians, flip: &Flip) -> (Vec<f64>, Vec<f64>) {
    let (mut min, mut max) = (vec![f64::INFINITY; 3], vec![f64::NEG_INFINITY; 3]);
    for mean in rows(gaussians).map(|row| flip.mean(row.mean).map(f64::from)) {
        for axis in 0..3 {
            min[axis] = min[axis].min(mean[axis]);
            max[axis] = max[axis].max(mean[axis]);
        }
    }
    (min, max)
}
