//! The three networks: their layers by the names of torchvision's files, and where the metric looks at them.

use super::convolution::Window;
use super::pool::Pool;

/// A network whose features are compared. Distances of different networks say nothing about each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum LpipsNetwork {
    /// VGG16, which most papers on novel view synthesis use.
    Vgg16,
    /// AlexNet, the default of the published program.
    AlexNet,
    /// SqueezeNet 1.1, the smallest.
    SqueezeNet,
}

impl LpipsNetwork {
    /// As tables name it: `vgg`, `alex` or `squeeze`, the names of the published program.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vgg16 => "vgg",
            Self::AlexNet => "alex",
            Self::SqueezeNet => "squeeze",
        }
    }
}

impl std::fmt::Display for LpipsNetwork {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A layer, without its weights. Every convolution is followed by ReLU.
#[derive(Debug, Clone)]
pub(super) enum LayerPlan {
    Convolution(ConvolutionPlan),
    /// SqueezeNet's: a 1 x 1 convolution, of which a 1 x 1 and a 3 x 3 are taken and joined.
    Fire {
        squeeze: ConvolutionPlan,
        expand: [ConvolutionPlan; 2],
    },
    Pool(Pool),
}

#[derive(Debug, Clone)]
pub(super) struct ConvolutionPlan {
    /// Before `.weight` and `.bias`.
    pub(super) name: String,
    pub(super) inputs: usize,
    pub(super) outputs: usize,
    pub(super) window: Window,
}

/// A layer, and whether its output is compared.
pub(super) type StepPlan = (LayerPlan, bool);

impl LpipsNetwork {
    /// The layers up to the last one that is compared.
    pub(super) fn plan(self) -> Vec<StepPlan> {
        match self {
            Self::Vgg16 => vgg16(),
            Self::AlexNet => alexnet(),
            Self::SqueezeNet => squeezenet(),
        }
    }
}

fn convolution(
    index: usize,
    inputs: usize,
    outputs: usize,
    side: usize,
    stride: usize,
    padding: usize,
) -> LayerPlan {
    let window = Window { side, stride, padding };
    LayerPlan::Convolution(ConvolutionPlan { name: format!("features.{index}"), inputs, outputs, window })
}

/// K. Simonyan, A. Zisserman, "Very deep convolutional networks for large-scale image recognition", 2015, table 1, D.
fn vgg16() -> Vec<StepPlan> {
    let pool = Pool { side: 2, stride: 2, is_partial: false };
    let (mut steps, mut index, mut inputs) = (Vec::new(), 0, 3);
    for (outputs, count) in [(64, 2), (128, 2), (256, 3), (512, 3), (512, 3)] {
        if index > 0 {
            steps.push((LayerPlan::Pool(pool), false));
            index += 1;
        }
        for i in 1..=count {
            steps.push((convolution(index, inputs, outputs, 3, 1, 1), i == count));
            // Convolution and ReLU count as two.
            index += 2;
            inputs = outputs;
        }
    }
    steps
}

/// A. Krizhevsky, "One weird trick for parallelizing convolutional neural networks", 2014, as torchvision has it.
fn alexnet() -> Vec<StepPlan> {
    let pool = || (LayerPlan::Pool(Pool { side: 3, stride: 2, is_partial: false }), false);
    vec![
        (convolution(0, 3, 64, 11, 4, 2), true),
        pool(),
        (convolution(3, 64, 192, 5, 1, 2), true),
        pool(),
        (convolution(6, 192, 384, 3, 1, 1), true),
        (convolution(8, 384, 256, 3, 1, 1), true),
        (convolution(10, 256, 256, 3, 1, 1), true),
    ]
}

/// F. Iandola et al., "SqueezeNet", 2016, version 1.1.
fn squeezenet() -> Vec<StepPlan> {
    let pool = || (LayerPlan::Pool(Pool { side: 3, stride: 2, is_partial: true }), false);
    let fire = |index: usize, inputs: usize, squeezed: usize, expanded: usize| {
        let part = |name: &str, inputs, outputs, side| ConvolutionPlan {
            name: format!("features.{index}.{name}"),
            inputs,
            outputs,
            window: Window { side, stride: 1, padding: side / 2 },
        };
        LayerPlan::Fire {
            squeeze: part("squeeze", inputs, squeezed, 1),
            expand: [part("expand1x1", squeezed, expanded, 1), part("expand3x3", squeezed, expanded, 3)],
        }
    };
    vec![
        (convolution(0, 3, 64, 3, 2, 0), true),
        pool(),
        (fire(3, 64, 16, 64), false),
        (fire(4, 128, 16, 64), true),
        pool(),
        (fire(6, 128, 32, 128), false),
        (fire(7, 256, 32, 128), true),
        pool(),
        (fire(9, 256, 48, 192), true),
        (fire(10, 384, 48, 192), true),
        (fire(11, 384, 64, 256), true),
        (fire(12, 512, 64, 256), true),
    ]
}
