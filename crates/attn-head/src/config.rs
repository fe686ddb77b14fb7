use crate::{Error, Result};
use serde::{Deserialize, Serialize};

/// Width of an anchor's feature vector between layers (paper, supplement: hidden width 128).
pub const WIDTH: usize = 128;
/// Attention heads.
pub const HEADS: usize = 4;
/// Width of one attention head.
pub const HEAD_WIDTH: usize = WIDTH / HEADS;
/// Outputs per anchor: opacity 1, scale 3, rotation 4, SH of degree 2 27, offset 3.
pub const OUTPUTS: usize = 38;
/// What is left of a neighbour before [`Kind::Mlp`] concatenates them all.
pub const MESSAGE: usize = 16;
/// Numbers of an anchor of which [`Kind::Grid`] takes the mean over a cell, for the fine cells and for the coarse ones each.
pub const CELL_WIDTH: usize = 32;

/// Largest number of features of either sort, well above what backbones have. It keeps a damaged file from asking for
/// all memory.
pub(crate) const LARGEST_FEATURES: usize = 4096;
/// Largest number of neighbours that a head is trained with; the paper's largest is 40.
const LARGEST_NEIGHBOURS: usize = 1024;

/// How neighbours are gathered (paper, section 3.3 and the ablation of heads).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Geo-aware attention, the paper's choice.
    Attention,
    /// A multilayer perceptron over the concatenated neighbours.
    Mlp,
    /// Edge convolutions as in DGCNN.
    EdgeConv,
    /// Maximum over neighbours as in PointNet.
    MaxPool,
    /// Means over the cells of a fine and a coarse grid, as in LoCoSplat (arXiv 2610.04351): one layer with a narrower perceptron, and no
    /// neighbours.
    Grid,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Self; 5] = [Self::Attention, Self::Mlp, Self::EdgeConv, Self::MaxPool, Self::Grid];

    /// Layers that look at other anchors.
    #[must_use]
    pub fn layers(self) -> usize {
        if self == Self::Grid { 1 } else { 3 }
    }

    /// Width of the hidden layer of a block's perceptron. That of the grid gives it about as many weights as LoCoSplat's head has, 0.14
    /// million.
    #[must_use]
    pub fn hidden(self) -> usize {
        if self == Self::Grid { 320 } else { 4 * WIDTH }
    }
}

/// Shape of a head.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// How neighbours are gathered.
    pub kind: Kind,
    /// Geometric features g per anchor, 1 to 4096.
    pub geometry: usize,
    /// Image features v per anchor, 1 to 4096.
    pub image: usize,
    /// Neighbours K that the head is trained with, up to 1024. All but the MLP take any number; the grid does not look at them.
    pub neighbours: usize,
}

impl Config {
    /// That the numbers are within their ranges.
    ///
    /// # Errors
    /// Naming the first that is not.
    pub fn check(&self) -> Result<()> {
        let ranges = [
            ("geometry", self.geometry, 1..=LARGEST_FEATURES),
            ("image", self.image, 1..=LARGEST_FEATURES),
            ("neighbours", self.neighbours, 0..=LARGEST_NEIGHBOURS),
        ];
        match ranges.into_iter().find(|(_, found, allowed)| !allowed.contains(found)) {
            Some((setting, found, allowed)) => Err(Error::Setting { setting, found, allowed }),
            None => Ok(()),
        }
    }

    /// That a head of this shape can look at `k` neighbours.
    pub(crate) fn check_neighbours(&self, k: usize) -> Result<()> {
        if self.kind == Kind::Mlp && k != self.neighbours {
            return Err(Error::NeighboursFixed { expected: self.neighbours, found: k });
        }
        Ok(())
    }
}
