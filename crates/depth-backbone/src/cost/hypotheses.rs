//! Which inverse depths are tried.

/// The inverse depths that are tried at each pixel.
#[derive(Clone, Copy)]
pub(crate) enum Hypotheses<'a> {
    /// The same at all pixels. Where a row begins in a source is computed in f64: it does not depend on the scale of the scene.
    Planes(&'a [f64]),
    /// `surface + offset`, within `ends` (smallest and largest). Windows follow the surface: each of their pixels is warped by its own depth.
    About {
        /// `[height, width]`.
        surface: &'a [f32],
        offsets: &'a [f32],
        ends: (f32, f32),
    },
}

impl<'a> Hypotheses<'a> {
    /// Number of inverse depths.
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::Planes(planes) => planes.len(),
            Self::About { offsets, .. } => offsets.len(),
        }
    }

    pub(super) fn surface(&self) -> Option<&'a [f32]> {
        match self {
            Self::Planes(_) => None,
            Self::About { surface, .. } => Some(surface),
        }
    }

    /// That number `index`.
    pub(super) fn get(&self, index: usize) -> Hypothesis {
        match self {
            Self::Planes(planes) => Hypothesis::Plane(planes[index]),
            Self::About { offsets, ends, .. } => Hypothesis::Offset(offsets[index], *ends),
        }
    }
}

/// One of them.
#[derive(Clone, Copy)]
pub(super) enum Hypothesis {
    Plane(f64),
    /// And the ends.
    Offset(f32, (f32, f32)),
}
