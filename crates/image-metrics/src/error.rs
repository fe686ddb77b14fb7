/// Why two pictures cannot be compared.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The pictures differ in size.
    #[error(
        "the first picture is {expected_width}x{expected_height}, the second {found_width}x{found_height}, expected equal sizes"
    )]
    SizeMismatch {
        /// Width of the first picture.
        expected_width: usize,
        /// Height of the first picture.
        expected_height: usize,
        /// Width of the second.
        found_width: usize,
        /// Height of the second.
        found_height: usize,
    },
    /// A picture is smaller than the window of the measure.
    #[error("the pictures are {width}x{height}, expected at least {minimum}x{minimum}")]
    TooSmall {
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Side of the window, pixels.
        minimum: usize,
    },
    /// A picture holds a NaN or an infinity.
    #[error("the {picture} picture is not finite in column {x}, row {y}")]
    NotFinite {
        /// `first`, `second`, `fitted` or `target`.
        picture: &'static str,
        /// Column of the pixel.
        x: usize,
        /// Row of the pixel.
        y: usize,
    },
    /// A value is too large to be compared in f32.
    #[error("the {picture} picture is beyond ±{limit} in column {x}, row {y}")]
    OutOfRange {
        /// `fitted` or `target`.
        picture: &'static str,
        /// Column of the pixel.
        x: usize,
        /// Row of the pixel.
        y: usize,
        /// Largest magnitude.
        limit: u32,
    },
    /// A slice does not fit the size of the picture.
    #[error(
        "the {picture} picture has {found} values, expected {expected} for {width}x{height} in three channels"
    )]
    Length {
        /// `first`, `second`, `fitted` or `target`.
        picture: &'static str,
        /// Pixels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Values of such a picture.
        expected: usize,
        /// Length of the slice.
        found: usize,
    },
    /// A gradient does not fit its picture.
    #[error("the gradient has {found} values, expected {expected}, as many as the picture")]
    GradientLength {
        /// Values of the picture.
        expected: usize,
        /// Length of the slice.
        found: usize,
    },
    /// Features of a picture are beyond the range of f32: its weights, or the picture, are extreme.
    #[cfg(feature = "lpips")]
    #[error("the network's features are not finite: its weights or the picture are extreme")]
    FeaturesOverflow,
    /// A file of weights cannot be read, or is none.
    #[cfg(feature = "lpips")]
    #[error("weights {}: cannot be read as a file of PyTorch or safetensors: {reason}", path.display())]
    WeightsUnreadable {
        /// The file.
        path: std::path::PathBuf,
        /// Why.
        reason: String,
    },
    /// A file of PyTorch without tensors by name.
    #[cfg(feature = "lpips")]
    #[error("weights {}: holds no state dictionary, expected tensors by name", path.display())]
    WeightsNone {
        /// The file.
        path: std::path::PathBuf,
    },
    /// A tensor of whole numbers.
    #[cfg(feature = "lpips")]
    #[error("weights {}: tensor {name} is of another type, expected floating-point numbers", path.display())]
    WeightsType {
        /// The file.
        path: std::path::PathBuf,
        /// The tensor.
        name: String,
    },
    /// The files hold tensors, but none of the networks.
    #[cfg(feature = "lpips")]
    #[error(
        "weights {}: their {found} tensors are none of VGG16, AlexNet and SqueezeNet 1.1, which features.0.weight tells: \
        give the network's file and that of the linear layers",
        listed(paths)
    )]
    WeightsUnknown {
        /// The files.
        paths: Vec<std::path::PathBuf>,
        /// Number of tensors.
        found: usize,
    },
    /// Tensors of the weights are missing, unexpected, misshapen or not finite.
    #[cfg(feature = "lpips")]
    #[error(
        "weights {} do not make LPIPS with {network}, the network's file and that of its linear layers: {}",
        listed(paths),
        tensor_files::first_few(problems)
    )]
    Weights {
        /// The files.
        paths: Vec<std::path::PathBuf>,
        /// The network that its shapes tell.
        network: crate::LpipsNetwork,
        /// All that does not fit.
        problems: Vec<crate::WeightProblem>,
    },
}

#[cfg(feature = "lpips")]
fn listed(paths: &[std::path::PathBuf]) -> String {
    paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ")
}

/// The result of this crate's operations.
pub type Result<T> = std::result::Result<T, Error>;
