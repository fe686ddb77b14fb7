use serde::Serialize;
use std::fmt;

/// What a frame did to the map.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Update {
    /// Number of the frame, from 0, refused ones counted.
    pub frame: usize,
    /// What became of it.
    pub outcome: Outcome,
    /// Wall time, seconds.
    pub seconds: f64,
    /// Gaussians of the map afterwards.
    pub gaussians: usize,
    /// Bytes of the map afterwards.
    pub bytes: usize,
}

/// What became of a frame.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// It changed the map.
    Keyframe(Integrated),
    /// The map shows it already; nothing changed.
    Seen(Seen),
    /// Stereo has no depth for it yet; nothing changed.
    Waiting(Waiting),
    /// It cannot be used; nothing changed.
    Refused(Refusal),
}

/// How far the map shows a frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Seen {
    /// Share of the picture where the map is thin, 0 to 1.
    pub thin: f64,
    /// Share of the content that an earlier keyframe saw from a similar distance and direction, 0 to 1.
    pub covered: f64,
    /// Share of the content in common with the most similar keyframe, 0 to 1.
    pub similar: f64,
}

/// What a keyframe changed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Integrated {
    /// How far the map showed it before.
    pub seen: Seen,
    /// PSNR of the map's rendering before it, dB; none if there was no map.
    pub psnr_before: Option<f64>,
    /// Share of its pixels that were open to be drawn.
    pub open: f64,
    /// Gaussians made of it.
    pub drawn: usize,
    /// Gaussians of the map that it confirmed.
    pub confirmed: usize,
    /// Gaussians of the map that it saw through, and that lost opacity.
    pub faded: usize,
    /// Gaussians that went because of that.
    pub removed: usize,
    /// Pairs that were merged to make room.
    pub merged: usize,
    /// Gaussians that were evicted to make room.
    pub evicted: usize,
}

/// Why stereo waits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Waiting {
    /// There are not enough keyframes from different places yet.
    FirstKeyframes,
    /// No kept keyframe shares content with it from another place.
    NoParallax,
    /// The keyframes do not tell a range of depths.
    NoRange,
}

/// Why a frame is refused.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Refusal {
    /// Its time stamp lies before that of an earlier frame.
    TimeBackwards {
        /// Its time, seconds.
        time: f64,
        /// The latest time so far, seconds.
        latest: f64,
    },
    /// Its time stamp is NaN or infinite.
    TimeNotFinite,
    /// It is much farther from the frame before than anything in sight. The next frame near this one is accepted.
    Jump {
        /// Distance from the frame before, scene units.
        distance: f64,
        /// Largest distance that is accepted, scene units.
        limit: f64,
    },
    /// One colour everywhere: a covered lens, a blank frame.
    NoContrast,
    /// Depth is to be measured, and the frame has none.
    NoDepth,
    /// A pixel that is NaN or infinite.
    PixelNotFinite {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TimeBackwards { time, latest } => {
                write!(
                    f,
                    "its time is {time} s, and that of an earlier frame {latest} s: expected times that do not decrease"
                )
            }
            Self::TimeNotFinite => write!(f, "its time is not a finite number"),
            Self::Jump { distance, limit } => {
                write!(
                    f,
                    "its camera is {distance:.3} scene units from that of the frame before, expected at most {limit:.3}"
                )
            }
            Self::NoContrast => write!(f, "its picture has one colour everywhere"),
            Self::NoDepth => write!(f, "it has no measured depth"),
            Self::PixelNotFinite { x, y } => {
                write!(f, "pixel ({x}, {y}) of its picture is not a finite number")
            }
        }
    }
}
