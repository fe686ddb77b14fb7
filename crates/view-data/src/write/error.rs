/// Why a data set cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteRule {
    /// The target has no name, as `..` has none.
    #[error("the folder has no name")]
    NoName,
    /// There is something in the target folder.
    #[error("the folder is not empty; choose another or remove it")]
    Occupied,
    /// A folder cannot be made.
    #[error("the folder cannot be made")]
    MakeFolder(#[source] std::io::Error),
    /// The finished folder cannot be given its name.
    #[error("the finished folder cannot be moved there")]
    Move(#[source] std::io::Error),
    /// A file cannot be written.
    #[error("a file cannot be written")]
    File(#[from] gs_scene::Error),
    /// A picture cannot be encoded.
    #[error("the picture cannot be encoded")]
    Encode(#[from] image::ImageError),
    /// A depth map cannot be encoded.
    #[error("the depth map cannot be encoded")]
    Exr(#[from] exr::error::Error),
    /// A frame's name makes no file name, or two frames have it.
    #[error("frame name {name:?} occurs twice or is no plain file name")]
    FrameName {
        /// The name.
        name: String,
    },
    /// There are no frames.
    #[error("there are no frames, expected at least one")]
    Empty,
    /// A lens other than a pinhole with radial and tangential distortion.
    #[error("frame {frame} has a lens other than a pinhole with k1 k2 k3 p1 p2; undistort it first")]
    LensModel {
        /// The frame.
        frame: String,
    },
    /// The Replica layout has pinhole pictures only.
    #[error(
        "frame {frame} has lens distortion, which the Replica layout cannot say; take nerfstudio or colmap"
    )]
    Distorted {
        /// The frame.
        frame: String,
    },
    /// The Replica layout has one camera for all frames.
    #[error(
        "frame {frame} has other intrinsics than the first one, the Replica layout has one camera for all"
    )]
    OtherLens {
        /// The frame.
        frame: String,
    },
    /// The scenes that lie there were taken with another camera.
    #[error("the scenes beside it were taken with another camera; take another folder")]
    OtherCamera,
}
