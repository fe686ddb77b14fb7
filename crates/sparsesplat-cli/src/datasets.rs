//! Data sets by name: which layouts they come in, and where they are had.

use crate::failure::Outcome;
use crate::given::Given;
use clap::ValueEnum;
use serde::Serialize;
use std::path::Path;
use view_data::Format;

/// Data sets and layouts that tables are made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Dataset {
    /// transforms.json and photographs
    Nerfstudio,
    /// COLMAP's sparse model and photographs
    Colmap,
    /// Replica as rendered for NICE-SLAM
    Replica,
    /// TUM RGB-D
    Tum,
    /// ScanNet, exported frame by frame
    Scannet,
    /// DL3DV: folders, or pixelSplat's chunks
    Dl3dv,
    /// RealEstate10K: camera text with frames, or pixelSplat's chunks
    Re10k,
    /// The scene of the demo, and generated scenes
    Simulated,
}

impl Dataset {
    /// The layout below a folder; none for what is simulated.
    pub(crate) fn format(self, root: &Path) -> Option<Format> {
        Some(match self {
            Self::Nerfstudio => Format::Nerfstudio,
            Self::Colmap => Format::Colmap,
            Self::Replica => Format::Replica,
            Self::Tum => Format::Tum,
            Self::Scannet => Format::ScanNet,
            Self::Dl3dv | Self::Re10k if has_chunks(root) => Format::Chunk,
            Self::Dl3dv => Format::Dl3dv,
            Self::Re10k => Format::Re10k,
            Self::Simulated => return None,
        })
    }

    /// Refuses settings of simulated scenes with a data set, and those of a data set with simulated scenes.
    pub(crate) fn refuse_without_effect(self, given: &Given) -> Outcome {
        if self != Self::Simulated {
            return given.refuse(
                &["scenes", "wild-scenes", "first-seed"],
                "it is for simulated scenes, and --dataset names another data set",
            );
        }
        given.refuse(
            &["root", "index", "views", "windows", "simulated-share"],
            if given.has("dataset") {
                "it is for data sets on disk, and --dataset simulated needs none: give --dataset LAYOUT, such as nerfstudio or colmap"
            } else {
                "it is for data sets on disk, and without --dataset LAYOUT (such as nerfstudio or colmap) scenes are simulated"
            },
        )
    }

    /// What is expected below --root, and where it is had.
    pub(crate) fn explanation(self) -> &'static str {
        match self {
            Self::Nerfstudio => {
                "expected DIR/transforms.json with its photographs, or folders of that kind in DIR"
            }
            Self::Colmap => {
                "expected DIR/sparse/0/{cameras,images}.bin (or .txt) and DIR/images/, or folders of that kind in DIR"
            }
            Self::Replica => {
                "expected the layout of NICE-SLAM:\n  \
                 DIR/cam_params.json\n  \
                 DIR/room0/traj.txt\n  \
                 DIR/room0/results/frame000000.jpg ... and depth000000.png ...\n  \
                 DIR/room1/... (8 scenes)\n\
                 Get it: https://cvg-data.inf.ethz.ch/nice-slam/data/Replica.zip (12 GB, under the Replica Research Terms; not to be \
                 redistributed)\n\
                 The original release (replica_v1/*/mesh.ply) has no photographs: `sparsesplat simulate replica_v1/room_0 --format \
                 replica` takes some.\n\
                 To try the layout without the data: `sparsesplat simulate --seed 0 --kind room --format replica --frames 60 -o DIR`"
            }
            Self::Tum => {
                "expected DIR/rgb.txt, depth.txt, groundtruth.txt, rgb/ and depth/, or folders of that kind in DIR\n\
                 Get it: https://cvg.cit.tum.de/data/datasets/rgbd-dataset/download"
            }
            Self::Scannet => {
                "expected DIR/color/, depth/, pose/ and intrinsic/, as ScanNet's SensReader exports them, or folders of that kind in DIR\n\
                 Get it: http://www.scan-net.org (terms of use to be signed)"
            }
            Self::Dl3dv => {
                "expected DIR/<hash>/nerfstudio/transforms.json (benchmark), DIR/<1K..11K>/<hash>/transforms.json, or pixelSplat's \
                 chunks DIR/test/{index.json,*.torch}\n\
                 Get it: https://github.com/DL3DV-10K/Dataset (access is granted on Hugging Face; CC BY-NC 4.0)\n\
                 Published windows: --index FILE with the evaluation index of pixelSplat or DepthSplat"
            }
            Self::Re10k => {
                "expected DIR/test/<key>.txt with frames in DIR/test/<key>/, or pixelSplat's chunks DIR/test/{index.json,*.torch}\n\
                 Get it: https://google.github.io/realestate10k (camera text; videos are not included)\n\
                 Published windows: --index FILE with the evaluation index of pixelSplat"
            }
            Self::Simulated => "nothing is expected: scenes are simulated",
        }
    }
}

/// Whether pixelSplat's chunks lie there.
fn has_chunks(root: &Path) -> bool {
    let is_chunk = |path: &Path| path.extension().is_some_and(|extension| extension == "torch");
    let holds_chunks = |folder: &Path| {
        std::fs::read_dir(folder).is_ok_and(|entries| entries.flatten().any(|entry| is_chunk(&entry.path())))
    };
    is_chunk(root)
        || holds_chunks(root)
        || ["test", "train"].iter().any(|part| holds_chunks(&root.join(part)))
}
