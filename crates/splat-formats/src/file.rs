use crate::error::Fault;
use crate::{Error, Format, Loss, Result, compressed_ply, glb, numbers, splat, spz};
use gs_scene::{Gaussians, PlyHeader, encode_ply, read_ply_vertices, write_atomically};
use std::fmt;
use std::fs::File;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;

/// A scene and the file that it comes from.
#[derive(Debug)]
pub struct Scene {
    /// The Gaussians, in PLY's axes (those of the data that the scene was made of).
    pub gaussians: Gaussians,
    /// The format, by the content of the file.
    pub format: Format,
    /// What else the file says, or has and is not read.
    pub remarks: Vec<Remark>,
}

/// What a file says besides its Gaussians, or has and is not read.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Remark {
    /// The scene was trained for a renderer with antialiasing (Mip-Splatting).
    Antialiased,
    /// Columns and elements of a PLY file that a Gaussian does not have, such as labels.
    Unread {
        /// Their names.
        names: Vec<String>,
    },
    /// Spherical harmonics of degree 4 were dropped.
    ShDegree4,
    /// An extension of SPZ was not read.
    SpzExtension {
        /// Its number, by vendor and kind.
        kind: u32,
    },
    /// Primitives of a glTF file that are no Gaussians, such as meshes.
    Primitives {
        /// How many.
        count: usize,
    },
}

impl fmt::Display for Remark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Antialiased => f.write_str(
                "was trained for a renderer with antialiasing; without it, it looks sharper or fainter",
            ),
            Self::Unread { names } => write!(f, "not read: {}", names.join(", ")),
            Self::ShDegree4 => f.write_str("spherical harmonics of degree 4 are dropped"),
            Self::SpzExtension { kind } => write!(f, "SPZ extension {kind:#010x} is not read"),
            Self::Primitives { count } => write!(f, "{count} primitives are no Gaussians, and not read"),
        }
    }
}

/// What the decoder of a format returns.
pub(crate) type Decoded = std::result::Result<(Gaussians, Vec<Remark>), Fault>;

/// Reads a scene in any [`Format`]. The format is recognised by the first bytes; `.splat` has none of its own, so a file with
/// other bytes is read as its extension says.
///
/// # Errors
/// If the file cannot be read, is in no known format, or breaks a rule of its format. Memory grows with the data that is
/// there, not with what a header promises.
pub fn read_scene(path: &Path) -> Result<Scene> {
    let io = |source| gs_scene::Error::Io { action: "read", path: path.to_path_buf(), source };
    let file = File::open(path).map_err(io)?;
    let mut reader = BufReader::with_capacity(1 << 20, file);
    let first = reader.fill_buf().map_err(io)?;
    let format = match first {
        [b'p', b'l', b'y', b'\n' | b'\r', ..] => Format::Ply,
        [0x1f, 0x8b, ..] | [b'N', b'G', b'S', b'P', ..] => Format::Spz,
        [b'g', b'l', b'T', b'F', ..] => Format::Glb,
        _ => Format::of_path(path).ok_or_else(|| Error::Unknown { path: path.to_path_buf() })?,
    };
    let fail = |format| {
        move |fault| match fault {
            Fault::Rule(rule) => Error::File { path: path.to_path_buf(), format, rule },
            Fault::Io(source) => io(source).into(),
        }
    };
    let (format, (gaussians, remarks)) = match format {
        Format::Ply | Format::CompressedPly => {
            let header = PlyHeader::read(&mut reader).map_err(io)?;
            let header = header.map_err(|rule| gs_scene::Error::Ply { path: path.to_path_buf(), rule })?;
            let mut remarks = if is_antialiased(&header) { vec![Remark::Antialiased] } else { Vec::new() };
            if compressed_ply::is_compressed(&header) {
                let format = Format::CompressedPly;
                let decoded = compressed_ply::decode(&header, &mut reader);
                (format, (decoded.map_err(fail(format))?, remarks))
            } else {
                remarks.extend(unread(&header));
                (Format::Ply, (read_ply_vertices(path, &header, &mut reader)?, remarks))
            }
        }
        Format::Spz => (format, spz::decode(&mut reader).map_err(fail(format))?),
        Format::Splat => (format, splat::decode(&mut reader).map_err(fail(format))?),
        Format::Glb => (format, glb::decode(&mut reader).map_err(fail(format))?),
    };
    if format != Format::Ply {
        numbers::check(&gaussians).map_err(|rule| fail(format)(rule.into()))?;
    }
    Ok(Scene { gaussians, format, remarks })
}

/// Whether a comment says so: `SplatRenderMode: mip` as Brush writes it, or `antialiased 1` as Postshot does.
fn is_antialiased(header: &PlyHeader) -> bool {
    let says = |comment: &String| ["splatrendermode: mip", "antialiased 1"].contains(&comment.as_str());
    header.comments.iter().map(|comment| comment.to_ascii_lowercase()).any(|comment| says(&comment))
}

/// What a plain PLY has besides Gaussians. Normals have no meaning there; every file has them.
fn unread(header: &PlyHeader) -> Option<Remark> {
    const READ: [&str; 11] =
        ["x", "y", "z", "nx", "ny", "nz", "opacity", "f_dc_", "f_rest_", "scale_", "rot_"];
    let is_read = |name: &str| {
        let stem = name.trim_end_matches(|letter: char| letter.is_ascii_digit());
        READ.contains(&stem)
    };
    let columns = header.elements.first().into_iter().flat_map(|vertex| &vertex.properties);
    let columns = columns.map(|property| property.name.clone()).filter(|name| !is_read(name));
    let elements = header.elements.iter().skip(1).map(|element| format!("element {}", element.name));
    let names: Vec<String> = columns.chain(elements).collect();
    (!names.is_empty()).then_some(Remark::Unread { names })
}

/// Writes a scene in the format that the extension of the path says, all or nothing.
///
/// Returns what the format does not keep; [`Encoder`] tells it before anything is written.
///
/// # Errors
/// If the extension names no format, the format cannot hold the scene, or the file cannot be written.
pub fn write_scene(path: &Path, gaussians: &Gaussians) -> Result<Vec<Loss>> {
    let format = Format::of_path(path).ok_or_else(|| Error::Extension { path: path.to_path_buf() })?;
    let encoder = Encoder::new(gaussians, format)?;
    write_atomically(path, |out| encoder.encode(out))?;
    Ok(encoder.losses)
}

/// A scene that is to be written, and what its format will not keep of it.
#[derive(Debug)]
pub struct Encoder<'a> {
    gaussians: &'a Gaussians,
    format: Format,
    losses: Vec<Loss>,
}

impl<'a> Encoder<'a> {
    /// Looks through the scene; nothing is written yet.
    ///
    /// # Errors
    /// If the format cannot hold the scene: it is empty, a number is not finite, or out of a range that is not clipped.
    pub fn new(gaussians: &'a Gaussians, format: Format) -> Result<Self> {
        let losses = match format {
            Format::Ply => Ok(Vec::new()),
            _ => numbers::check(gaussians).and_then(|()| match format {
                Format::Ply => Ok(Vec::new()),
                Format::CompressedPly => Ok(compressed_ply::losses(gaussians)),
                Format::Spz => spz::losses(gaussians),
                Format::Splat => Ok(splat::losses(gaussians)),
                Format::Glb => glb::losses(gaussians),
            }),
        };
        let losses = losses.map_err(|rule| Error::Unfit { format, rule })?;
        Ok(Self { gaussians, format, losses })
    }

    /// What the format does not keep of this scene; nothing for PLY.
    #[must_use]
    pub fn losses(&self) -> &[Loss] {
        &self.losses
    }

    /// Writes the bytes of the file. The same scene gives the same bytes.
    ///
    /// # Errors
    /// If `out` takes no more.
    pub fn encode(&self, out: &mut dyn Write) -> std::io::Result<()> {
        match self.format {
            Format::Ply => encode_ply(out, self.gaussians),
            Format::CompressedPly => compressed_ply::encode(self.gaussians, out),
            Format::Spz => spz::encode(self.gaussians, out),
            Format::Splat => splat::encode(self.gaussians, out),
            Format::Glb => glb::encode(self.gaussians, out),
        }
    }
}
