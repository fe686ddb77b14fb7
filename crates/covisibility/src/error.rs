use crate::{Anchors, Settings};
use gs_scene::Camera;

/// Why there are no neighbours.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// An array of the anchors that is not as long as their positions.
    #[error("{what} has {found} entries, expected {expected}: one per anchor")]
    Count {
        /// `views`, `pixels` or `depths`.
        what: &'static str,
        /// Number of positions.
        expected: usize,
        /// Entries given.
        found: usize,
    },
    /// More anchors than a 32-bit index can name.
    #[error("{found} anchors, expected at most {}: split the set", u32::MAX - 1)]
    TooMany {
        /// Anchors given.
        found: usize,
    },
    /// A view that has no camera.
    #[error("anchor {anchor} is of view {found}, expected a view below {views}")]
    View {
        /// Index of the anchor.
        anchor: usize,
        /// Its view.
        found: u32,
        /// Number of cameras.
        views: usize,
    },
    /// A pixel that the anchor's view does not have.
    #[error("anchor {anchor} is pixel {found} of view {view}, expected a pixel below {pixels}")]
    Pixel {
        /// Index of the anchor.
        anchor: usize,
        /// Its view.
        view: u32,
        /// Its pixel.
        found: u32,
        /// Pixels of the view.
        pixels: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error(
        "anchor {anchor} is at ({}, {}, {}), expected finite coordinates: drop or mend it first",
        found[0], found[1], found[2]
    )]
    Position {
        /// Index of the anchor.
        anchor: usize,
        /// Its coordinates.
        found: [f64; 3],
    },
    /// A depth is NaN or infinite.
    #[error("depth of anchor {anchor} is {found}, expected a finite number: drop or mend it first")]
    Depth {
        /// Index of the anchor.
        anchor: usize,
        /// Its depth.
        found: f32,
    },
    /// A radius or tolerance that is negative, NaN or infinite.
    #[error("{what} is {found}, expected a finite number of at least 0")]
    Setting {
        /// `radius` or `tolerance`.
        what: &'static str,
        /// The value given.
        found: f64,
    },
}

/// This crate's result.
pub type Result<T> = std::result::Result<T, Error>;

/// The settings first, then the lengths, then the first anchor that is wrong.
pub(crate) fn check(anchors: &Anchors, cameras: &[Camera], settings: &Settings) -> Result<()> {
    for (what, found) in [("radius", settings.radius), ("tolerance", settings.tolerance)] {
        if !(found.is_finite() && found >= 0.0) {
            return Err(Error::Setting { what, found });
        }
    }
    let &Anchors { positions, views, pixels, depths } = anchors;
    let expected = positions.len();
    for (what, found) in [("views", views.len()), ("pixels", pixels.len()), ("depths", depths.len())] {
        if found != expected {
            return Err(Error::Count { what, expected, found });
        }
    }
    if expected >= u32::MAX as usize {
        return Err(Error::TooMany { found: expected });
    }
    let sizes: Vec<usize> = cameras.iter().map(|camera| camera.width() * camera.height()).collect();
    for anchor in 0..expected {
        let (view, pixel) = (views[anchor], pixels[anchor]);
        let Some(&size) = sizes.get(view as usize) else {
            return Err(Error::View { anchor, found: view, views: cameras.len() });
        };
        if pixel as usize >= size {
            return Err(Error::Pixel { anchor, view, found: pixel, pixels: size });
        }
        if !positions[anchor].iter().all(|c| c.is_finite()) {
            return Err(Error::Position { anchor, found: positions[anchor] });
        }
        if !depths[anchor].is_finite() {
            return Err(Error::Depth { anchor, found: depths[anchor] });
        }
    }
    Ok(())
}
