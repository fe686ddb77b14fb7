//! The published checkpoints of DepthSplat: which there are, where they are looked for.

use crate::failure::{Failure, Outcome};
use std::env;
use std::path::{Path, PathBuf};

/// A published checkpoint.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Checkpoint {
    /// What `weights --fetch` calls it.
    pub(crate) name: &'static str,
    /// Its file, which ends in the start of its SHA-256.
    pub(crate) file: &'static str,
    /// What it was trained on, and for how many views of which size.
    pub(crate) trained: &'static str,
}

/// All of them, the preferred one first: the only one whose ViT is free for any use.
pub(crate) const PUBLISHED: [Checkpoint; 9] = [
    published(
        "small-dl3dv",
        "depthsplat-gs-small-re10kdl3dv-448x768-randview4-10-c08188db.pth",
        "RealEstate10K and DL3DV, 4 to 10 views of 768x448",
    ),
    published(
        "base-dl3dv",
        "depthsplat-gs-base-dl3dv-256x448-randview2-6-02c7b19d.pth",
        "DL3DV, 2 to 6 views of 448x256: the network of its DL3DV tables",
    ),
    published(
        "base-dl3dv-large",
        "depthsplat-gs-base-re10kdl3dv-448x768-randview2-6-f8ddd845.pth",
        "RealEstate10K and DL3DV, 2 to 6 views of 768x448",
    ),
    published(
        "small-re10k",
        "depthsplat-gs-small-re10k-256x256-view2-cfeab6b1.pth",
        "RealEstate10K, 2 views of 256x256",
    ),
    published(
        "base-re10k",
        "depthsplat-gs-base-re10k-256x256-view2-ca7b6795.pth",
        "RealEstate10K, 2 views of 256x256",
    ),
    published(
        "base-re10k-wide",
        "depthsplat-gs-base-re10k-256x448-view2-fea94f65.pth",
        "RealEstate10K, 2 views of 448x256",
    ),
    published(
        "large-re10k",
        "depthsplat-gs-large-re10k-256x256-view2-e0f0f27a.pth",
        "RealEstate10K, 2 views of 256x256",
    ),
    published(
        "small-depth",
        "depthsplat-depth-small-352x640-randview2-8-e807bd82.pth",
        "depth alone, 2 to 8 views of 640x352",
    ),
    published(
        "base-depth",
        "depthsplat-depth-base-352x640-randview2-8-65a892c5.pth",
        "depth alone, 2 to 8 views of 640x352",
    ),
];

const fn published(name: &'static str, file: &'static str, trained: &'static str) -> Checkpoint {
    Checkpoint { name, file, trained }
}

/// Where they are published.
pub(crate) const REPOSITORY: &str = "haofeixu/depthsplat";
/// What their licences say, as far as we know.
pub(crate) const LICENCE: &str = "DepthSplat is under the MIT licence. Its small models start from Depth Anything V2 Small (Apache 2.0), base and \
    large from weights under CC BY-NC 4.0, and DL3DV is CC BY-NC 4.0: ask the authors before commercial use";
/// The folder that overrides the usual one.
pub(crate) const VARIABLE: &str = "SPARSESPLAT_WEIGHTS";

impl Checkpoint {
    /// Where it is had.
    pub(crate) fn address(&self) -> String {
        format!("https://huggingface.co/{REPOSITORY}/resolve/main/{}", self.file)
    }
}

/// The folder that checkpoints are looked for in; none where the system names no home.
pub(crate) fn folder() -> Option<PathBuf> {
    folder_of(|name| env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from))
}

fn folder_of(variable: impl Fn(&str) -> Option<PathBuf>) -> Option<PathBuf> {
    let of_system = || {
        let data = variable("XDG_DATA_HOME").or_else(|| variable("LOCALAPPDATA"));
        let data = data.or_else(|| Some(variable("HOME")?.join(".local").join("share")))?;
        Some(data.join("sparsesplat").join("weights"))
    };
    variable(VARIABLE).or_else(of_system)
}

/// The published checkpoints that lie in a folder, the preferred one first.
pub(crate) fn present(folder: &Path) -> Vec<(Checkpoint, PathBuf)> {
    let pair = |checkpoint: Checkpoint| (checkpoint, folder.join(checkpoint.file));
    PUBLISHED.into_iter().map(pair).filter(|(_, path)| path.is_file()).collect()
}

/// The checkpoint to use where none is named: the preferred one of those that are there with a head.
pub(crate) fn preferred() -> Outcome<PathBuf> {
    let folder = folder();
    let found = folder.as_deref().map(present).unwrap_or_default();
    let whole = found.into_iter().find(|(checkpoint, _)| !checkpoint.name.ends_with("depth"));
    whole.map(|(_, path)| path).ok_or_else(|| {
        let looked = folder.map_or("nowhere: no home folder".to_owned(), |folder| folder.display().to_string());
        let first = PUBLISHED[0];
        Failure::lines(format!(
            "--backbone depthsplat needs weights, and none were found (looked for in {looked})\n\
             `cargo xtask weights --fetch {}` places them there; or fetch {}\n\
             and give it as --weights FILE. `sparsesplat weights` lists all that are published, with their licences.",
            first.name,
            first.address()
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_ends_in_its_hash_and_names_are_unique() {
        for (i, checkpoint) in PUBLISHED.iter().enumerate() {
            let stem = checkpoint.file.strip_suffix(".pth").unwrap();
            let (_, hash) = stem.rsplit_once('-').unwrap();
            assert!(hash.len() == 8 && u32::from_str_radix(hash, 16).is_ok(), "{}", checkpoint.file);
            assert!(PUBLISHED[..i].iter().all(|other| other.name != checkpoint.name));
        }
    }

    #[test]
    fn the_folder_is_the_variable_or_the_systems() {
        let with = |pairs: &'static [(&str, &str)]| {
            let value = |name: &str| pairs.iter().find(|(n, _)| *n == name).map(|(_, v)| PathBuf::from(v));
            folder_of(value)
        };
        assert_eq!(with(&[]), None);
        assert_eq!(with(&[("SPARSESPLAT_WEIGHTS", "w"), ("HOME", "h")]), Some("w".into()));
        assert_eq!(with(&[("HOME", "h")]), Some("h/.local/share/sparsesplat/weights".into()));
        assert_eq!(with(&[("XDG_DATA_HOME", "d"), ("HOME", "h")]), Some("d/sparsesplat/weights".into()));
    }

    #[test]
    fn those_in_a_folder_are_found_in_order() {
        let folder = tempfile::tempdir().unwrap();
        assert!(present(folder.path()).is_empty());
        for checkpoint in [PUBLISHED[3], PUBLISHED[1]] {
            std::fs::write(folder.path().join(checkpoint.file), b"").unwrap();
        }
        let names: Vec<&str> = present(folder.path()).iter().map(|(checkpoint, _)| checkpoint.name).collect();
        assert_eq!(names, ["base-dl3dv", "small-re10k"]);
    }
}
