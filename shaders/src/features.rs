/// What a view asks for. Everything else is specialised away.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Features {
    /// Degree of the spherical harmonics, 0 to 3.
    pub sh_degree: u32,
    /// Whether the opacity of Gaussians smaller than a pixel is compensated for the low-pass filter.
    pub antialias: bool,
    /// Whether Σ w z is rendered.
    pub depth: bool,
}

impl Features {
    /// Every combination.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..4).flat_map(|sh_degree| {
            [false, true].into_iter().flat_map(move |antialias| {
                [false, true].into_iter().map(move |depth| Self { sh_degree, antialias, depth })
            })
        })
    }
}
