use crate::{Config, Error, Result};

/// What a head sees of `n` anchors with `k` neighbours each.
#[derive(Debug, Clone, Copy)]
pub struct Inputs<'a> {
    /// Number of anchors.
    pub n: usize,
    /// Neighbours per anchor, without the anchor itself.
    pub k: usize,
    /// Geometric features g, `[n, config.geometry]`.
    pub geometry: &'a [f32],
    /// Image features v, `[n, config.image]`.
    pub image: &'a [f32],
    /// Index of each neighbour, `[n, k]`.
    pub neighbours: &'a [u32],
    /// Where each neighbour lies as seen from its anchor, p_j - p_i, `[n, k, 3]`; in whatever frame and unit the
    /// head is trained with. That of the anchor itself, 0, is not stored.
    pub relative: &'a [[f32; 3]],
}

impl Inputs<'_> {
    /// Lengths agree with each other and with `config`, and neighbours exist.
    ///
    /// # Errors
    /// Naming what does not fit.
    pub fn check(&self, config: &Config) -> Result<()> {
        let &Self { n, k, .. } = self;
        let lengths = [
            ("geometry", n * config.geometry, self.geometry.len()),
            ("image", n * config.image, self.image.len()),
            ("neighbours", n * k, self.neighbours.len()),
            ("relative", n * k, self.relative.len()),
        ];
        for (what, expected, found) in lengths {
            if expected != found {
                return Err(Error::Length { what, expected, found });
            }
        }
        match self.neighbours.iter().position(|&j| j as usize >= n) {
            Some(at) => Err(Error::Neighbour { anchor: at / k, found: self.neighbours[at], n }),
            None => Ok(()),
        }
    }
}
