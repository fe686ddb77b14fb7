use std::fmt;
use std::path::Path;

/// A file format of 3D Gaussian scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Format {
    /// PLY as the original 3D Gaussian splatting writes it; keeps every bit.
    Ply,
    /// Compressed PLY of PlayCanvas and SuperSplat.
    CompressedPly,
    /// SPZ of Niantic: versions 1 to 3 are read, version 3 is written.
    Spz,
    /// `.splat` of antimatter15.
    Splat,
    /// Binary glTF with `KHR_gaussian_splatting`.
    Glb,
}

impl Format {
    /// All formats.
    pub const ALL: [Self; 5] = [Self::Ply, Self::CompressedPly, Self::Spz, Self::Splat, Self::Glb];

    /// The extensions of [`Self::ALL`], for messages.
    pub(crate) const LIST: &str = ".ply, .compressed.ply, .spz, .splat or .glb";

    /// The extension of files in this format, without the leading dot.
    #[must_use]
    pub fn extension(self) -> &'static str {
        match self {
            Self::Ply => "ply",
            Self::CompressedPly => "compressed.ply",
            Self::Spz => "spz",
            Self::Splat => "splat",
            Self::Glb => "glb",
        }
    }

    /// The format that a file name says, in letters of either case; `None` if it says none.
    #[must_use]
    pub fn of_path(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_str()?.to_ascii_lowercase();
        let has =
            |format: &&Self| name.strip_suffix(format.extension()).is_some_and(|stem| stem.ends_with('.'));
        // .compressed.ply ends in .ply as well.
        Self::ALL.iter().filter(has).max_by_key(|format| format.extension().len()).copied()
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Ply => "PLY",
            Self::CompressedPly => "compressed PLY",
            Self::Spz => "SPZ",
            Self::Splat => ".splat",
            Self::Glb => "glTF",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_say_their_format() {
        for (name, format) in [
            ("a.ply", Some(Format::Ply)),
            ("out/A.Compressed.PLY", Some(Format::CompressedPly)),
            ("compressed.ply", Some(Format::Ply)),
            ("a.b.spz", Some(Format::Spz)),
            (".splat", Some(Format::Splat)),
            ("a.glb", Some(Format::Glb)),
            ("a.gltf", None),
            ("ply", None),
            ("a.ply/..", None),
            ("a.ply.gz", None),
        ] {
            assert_eq!(Format::of_path(Path::new(name)), format, "{name}");
        }
    }
}
