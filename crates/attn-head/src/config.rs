use serde::{Deserialize, Serialize};

/// Width of an anchor's feature vector between layers (paper, supplement: hidden width 128).
pub const WIDTH: usize = 128;
/// Attention heads.
pub const HEADS: usize = 4;
/// Width of one attention head.
pub const HEAD_WIDTH: usize = WIDTH / HEADS;
/// Layers that look at neighbours.
pub const LAYERS: usize = 3;
/// Outputs per anchor: opacity 1, scale 3, rotation 4, SH of degree 2 27, offset 3.
pub const OUTPUTS: usize = 38;

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
}

/// Shape of a head.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// How neighbours are gathered.
    pub kind: Kind,
    /// Geometric features g per anchor.
    pub geometry: usize,
    /// Image features v per anchor.
    pub image: usize,
    /// Neighbours K that the head is trained with. All but the MLP take any number.
    pub neighbours: usize,
}
