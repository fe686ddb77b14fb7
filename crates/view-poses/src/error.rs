use std::path::PathBuf;

/// Result of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Why there are no poses.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder cannot be read or written.
    #[error("{}: cannot {action}", path.display())]
    File {
        /// What was tried: read, copy, remove.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: std::io::Error,
    },
    /// A picture cannot be read, or the data set cannot be written.
    #[error(transparent)]
    Data(#[from] view_data::Error),
    /// Neither a folder nor a video.
    #[error("{}: expected a folder of photographs, or a video ({})", path.display(), crate::video::VIDEOS.join(", "))]
    NoInput {
        /// The file.
        path: PathBuf,
    },
    /// The folder has no PNG or JPEG files.
    #[error("{}: no photographs found; expected PNG or JPEG files in it or in its folder images{}", path.display(), others(*other))]
    NoPhotographs {
        /// The folder.
        path: PathBuf,
        /// Pictures in other formats.
        other: usize,
    },
    /// Too few photographs are left.
    #[error("{}: {usable} of {found} photographs can be used, expected at least {MINIMUM} from different places{}", path.display(), listed(reasons))]
    TooFew {
        /// The folder or video.
        path: PathBuf,
        /// Photographs in it.
        found: usize,
        /// Those that are left.
        usable: usize,
        /// Why the others are not: picture and reason.
        reasons: Vec<String>,
    },
    /// More photographs than are matched pair by pair.
    #[error("{}: {found} photographs, expected at most {limit}: every pair is matched, so the time grows with the square; take fewer of them", path.display())]
    TooMany {
        /// The folder.
        path: PathBuf,
        /// Photographs in it.
        found: usize,
        /// The limit.
        limit: usize,
    },
    /// All frames of a video are alike.
    #[error("{}: the camera stands still: {frames} frames were looked at and {different} differ; expected a camera that moves through the scene", path.display())]
    StandsStill {
        /// The video.
        path: PathBuf,
        /// Frames that were compared.
        frames: usize,
        /// How many of them differ from the one before.
        different: usize,
    },
    /// A file does not say how a world was levelled.
    #[error("{}: no levelling to undo in it, expected the poses.json of a data set that `poses` wrote", path.display())]
    NoLevelling {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        #[source]
        source: LevellingFault,
    },
    /// A program is not on the PATH.
    #[error("{program} is needed {purpose} and is not on the PATH; {install}")]
    NoProgram {
        /// The program.
        program: &'static str,
        /// What for.
        purpose: &'static str,
        /// How to get it.
        install: &'static str,
    },
    /// A program is too old.
    #[error("this version of {program} has no command {command}; version {since} has it")]
    NoCommand {
        /// The program.
        program: &'static str,
        /// Its command.
        command: &'static str,
        /// First version that has it.
        since: u32,
    },
    /// A program does not run to its end.
    #[error("{program} {step} failed ({status}): {said}")]
    Program {
        /// The program.
        program: String,
        /// Its command.
        step: String,
        /// Its exit status.
        status: std::process::ExitStatus,
        /// The last lines that it wrote.
        said: String,
    },
    /// A video without frames.
    #[error("{}: no frames can be decoded{}", path.display(), if said.is_empty() { String::new() } else { format!(": {said}") })]
    NoFrames {
        /// The video.
        path: PathBuf,
        /// What ffmpeg said.
        said: String,
    },
    /// ffmpeg's output ends inside a picture, or is not what was asked for.
    #[error("{}: ffmpeg delivered a picture that cannot be read", path.display())]
    FrameStream {
        /// The video.
        path: PathBuf,
    },
    /// The engine is not part of this build.
    #[error(
        "the engine openmvg is not part of this build; build with `--features openmvg --ignore-rust-version` (`cargo xtask` does), or install COLMAP ({})",
        crate::colmap::INSTALL
    )]
    NotBuilt,
    /// No two photographs show the same part of a scene.
    #[error(
        "none of the {photographs} photographs overlap ({engine}: {said}); expected photographs of one scene in which neighbours share at least half of their content, with texture, taken from different places"
    )]
    NothingMatches {
        /// How many there are.
        photographs: usize,
        /// The engine.
        engine: &'static str,
        /// Its message.
        said: String,
    },
    /// The engine failed.
    #[cfg(feature = "openmvg")]
    #[error("openmvg failed")]
    OpenMvg(#[from] openmvg_sfm::SfmError),
    /// A result that is certainly wrong.
    #[error("no usable poses ({engine}): {}; {advice}", doubts.join("; "))]
    Lost {
        /// The engine.
        engine: String,
        /// What is wrong.
        doubts: Vec<String>,
        /// What to do.
        advice: String,
    },
}

/// What is wrong with the levelling in a file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LevellingFault {
    /// It is no JSON, or has other keys.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// Its matrix does not rotate.
    #[error("rotation is {found:?}, expected a rotation matrix")]
    Rotation {
        /// Its rows.
        found: [[f64; 3]; 3],
    },
    /// Its origin or scale cannot be divided out.
    #[error("origin and scale are {origin:?} and {scale}, expected numbers, and a scale above 0")]
    OriginOrScale {
        /// Its origin.
        origin: [f64; 3],
        /// Its scale.
        scale: f64,
    },
}

/// Fewest photographs from which poses follow.
pub(crate) const MINIMUM: usize = 2;

fn others(count: usize) -> String {
    match count {
        0 => String::new(),
        count => format!(" ({count} pictures in other formats: convert them to JPEG or PNG)"),
    }
}

fn listed(reasons: &[String]) -> String {
    const SHOWN: usize = 4;
    match reasons.len() {
        0 => String::new(),
        n if n <= SHOWN => format!(" ({})", reasons.join("; ")),
        n => format!(" ({}; and {} more)", reasons[..SHOWN].join("; "), n - SHOWN),
    }
}
