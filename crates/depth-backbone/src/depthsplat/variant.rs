//! The four layouts of the network and the three sizes of its ViT.

/// The vision transformer that looks at each view alone (DINOv2, patches of 14 pixels).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Vit {
    /// 384 channels, 12 blocks: the published "small" models.
    Small,
    /// 768 channels, 12 blocks: "base".
    Base,
    /// 1024 channels, 24 blocks: "large".
    Large,
}

impl Vit {
    /// All sizes.
    pub const ALL: [Self; 3] = [Self::Small, Self::Base, Self::Large];

    /// The name in the original's configuration: `vits`, `vitb`, `vitl`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Small => "vits",
            Self::Base => "vitb",
            Self::Large => "vitl",
        }
    }

    /// Channels of a token.
    pub(super) fn width(self) -> usize {
        match self {
            Self::Small => 384,
            Self::Base => 768,
            Self::Large => 1024,
        }
    }

    pub(super) fn depth(self) -> usize {
        match self {
            Self::Small | Self::Base => 12,
            Self::Large => 24,
        }
    }

    /// Blocks whose tokens are handed on.
    pub(super) fn tapped(self) -> [usize; 4] {
        match self {
            Self::Small | Self::Base => [2, 5, 8, 11],
            Self::Large => [4, 11, 17, 23],
        }
    }

    /// Channels of the four maps in the DPT heads.
    pub(super) fn dpt_channels(self) -> [usize; 4] {
        let first = match self {
            Self::Small => 48,
            Self::Base => 96,
            Self::Large => 128,
        };
        [first, 2 * first, 4 * first, 8 * first]
    }

    /// Channels of the DPT head that refines depth; the one for features has twice as many.
    pub(super) fn dpt_width(self) -> usize {
        match self {
            Self::Small => 32,
            Self::Base => 48,
            Self::Large => 64,
        }
    }
}

/// At which resolutions the network matches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Scales {
    /// One cost volume at 1/4 (`s1_u4l4`).
    Quarter,
    /// One cost volume at 1/8 (`s1_u8l8`).
    Eighth,
    /// Cost volumes at 1/8 and 1/4 (`s2_u4l8`).
    EighthQuarter,
    /// Cost volumes at 1/4 and 1/2 (`s2_u2l4`).
    QuarterHalf,
}

impl Scales {
    /// All layouts.
    pub const ALL: [Self; 4] = [Self::Quarter, Self::Eighth, Self::EighthQuarter, Self::QuarterHalf];

    /// Number of scales, upsampling factor, lowest resolution of the features, in the original's order.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Quarter => "s1_u4l4",
            Self::Eighth => "s1_u8l8",
            Self::EighthQuarter => "s2_u4l8",
            Self::QuarterHalf => "s2_u2l4",
        }
    }

    /// Number of cost volumes.
    pub(super) fn count(self) -> usize {
        match self {
            Self::Quarter | Self::Eighth => 1,
            Self::EighthQuarter | Self::QuarterHalf => 2,
        }
    }

    /// Image size over that of the last scale.
    pub(super) fn upsampling(self) -> usize {
        match self {
            Self::Quarter | Self::EighthQuarter => 4,
            Self::Eighth => 8,
            Self::QuarterHalf => 2,
        }
    }

    /// Image size over that of the coarsest features.
    pub(super) fn lowest(self) -> usize {
        match self {
            Self::Quarter | Self::QuarterHalf => 4,
            Self::Eighth | Self::EighthQuarter => 8,
        }
    }

    /// Image sides are a multiple of this: the windows are halved once, the U-Nets' maps two or three times.
    pub(super) fn multiple(self) -> usize {
        match self {
            Self::Quarter | Self::QuarterHalf => 16,
            Self::Eighth | Self::EighthQuarter => 32,
        }
    }
}

/// A layout with a ViT.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Variant {
    /// Resolutions of the cost volumes.
    pub scales: Scales,
    /// Size of the ViT.
    pub vit: Vit,
}

impl Variant {
    /// All twelve; six of them have published weights.
    pub fn all() -> impl Iterator<Item = Self> {
        Scales::ALL.into_iter().flat_map(|scales| Vit::ALL.map(|vit| Self { scales, vit }))
    }

    /// The variant of a checkpoint, from the shapes of its tensors by name (as in the GS checkpoints, without
    /// `encoder.`). The width of the ViT and the inputs of the DPT head's joints are different in each.
    pub(super) fn detect(shape: impl Fn(&str) -> Option<Vec<usize>>) -> Option<Self> {
        let joints: Vec<Vec<usize>> = (0..3)
            .map(|k| shape(&format!("depth_predictor.upsampler.concat_projects.{k}.weight")))
            .collect::<Option<_>>()?;
        let inputs: Vec<Option<usize>> = joints.iter().map(|s| s.get(1).copied()).collect();
        let token = shape("depth_predictor.pretrained.cls_token")?.last().copied()?;
        Self::all().find(|variant| {
            variant.vit.width() == token
                && variant.joint_channels(true).iter().zip(&inputs).all(|(&n, &found)| Some(n) == found)
        })
    }

    /// Input channels of the DPT head's three joints, with the coarse inverse depth or without.
    pub(super) fn joint_channels(&self, with_depth: bool) -> [usize; 3] {
        let [l1, l2, l3, _] = self.vit.dpt_channels();
        let z = usize::from(with_depth);
        match self.scales {
            Scales::Eighth => [64 + l1, 96 + l2, 128 + l3 + 128 + z],
            Scales::Quarter => [64 + 96 + l1, 128 + l2 + 128 + z, l3],
            Scales::EighthQuarter => [64 + l1, 96 + l2 + 64 + z, 128 + l3 + 128],
            Scales::QuarterHalf => [64 + 96 + 64 + z + l1, 128 + l2 + 128, l3],
        }
    }
}

impl std::fmt::Display for Variant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {}", self.scales.name(), self.vit.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_are_those_of_the_published_layouts() {
        let joints = |scales, vit| Variant { scales, vit }.joint_channels(true);
        assert_eq!(joints(Scales::Quarter, Vit::Small), [208, 353, 192]);
        assert_eq!(joints(Scales::Eighth, Vit::Small), [112, 192, 449]);
        assert_eq!(joints(Scales::EighthQuarter, Vit::Base), [160, 353, 640]);
        assert_eq!(joints(Scales::QuarterHalf, Vit::Large), [353, 512, 512]);
        for variant in Variant::all() {
            let found = Variant::detect(|name| {
                match name.strip_prefix("depth_predictor.upsampler.concat_projects.") {
                    Some(rest) => {
                        let k: usize = rest.split('.').next()?.parse().ok()?;
                        Some(vec![7, variant.joint_channels(true)[k], 1, 1])
                    }
                    None => (name == "depth_predictor.pretrained.cls_token")
                        .then(|| vec![1, 1, variant.vit.width()]),
                }
            });
            assert_eq!(found, Some(variant));
        }
        assert_eq!(Variant::detect(|_| None), None);
        assert_eq!(Variant::detect(|_| Some(vec![])), None);
        assert_eq!(Variant::detect(|_| Some(vec![1, 384, 384])), None);
    }
}
