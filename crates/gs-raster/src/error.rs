//! Errors of the crate.

/// What can be wrong with a request to render.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A setting lies outside its range.
    #[error("render setting {name} is {found}, expected {expected}")]
    Setting {
        /// Field of [`RenderSettings`](crate::RenderSettings).
        name: &'static str,
        /// The value given.
        found: f32,
        /// The range.
        expected: &'static str,
    },
    /// The lists of Gaussians per tile would not fit into memory.
    #[error(
        "the Gaussians touch {found} tiles in all, more than {limit}: render fewer or smaller Gaussians, \
         or a smaller image"
    )]
    TooManyIntersections {
        /// Pairs of a Gaussian and a tile that it touches.
        found: u64,
        /// The most that are accepted.
        limit: u64,
    },
    /// The scene is not the one that was recorded.
    #[error(
        "{found} Gaussians of SH degree {found_degree}, but {expected} of degree {expected_degree} were recorded"
    )]
    OtherScene {
        /// Gaussians recorded.
        expected: usize,
        /// Their SH degree.
        expected_degree: usize,
        /// Gaussians given.
        found: usize,
        /// Their SH degree.
        found_degree: usize,
    },
    /// The arrays of activated Gaussians have no gradients on a tape of stored Gaussians.
    #[error("the tape is of stored Gaussians: call `backward`, or record by `record_activated`")]
    NotActivated,
    /// An array of activated Gaussians does not have the length that their number asks for.
    #[error("{what}: {found} numbers for {gaussians} Gaussians, expected {expected}")]
    ArrayLength {
        /// Field of [`Activated`](crate::Activated).
        what: &'static str,
        /// How many Gaussians there are, by the opacities.
        gaussians: usize,
        /// Numbers expected.
        expected: usize,
        /// Numbers found.
        found: usize,
    },
    /// There are fewer SH coefficients than the degree needs.
    #[error("colors: {found} SH coefficients per Gaussian, degree {degree} needs {expected}")]
    Coefficients {
        /// SH degree.
        degree: usize,
        /// Coefficients per Gaussian that it needs.
        expected: usize,
        /// Coefficients per Gaussian given.
        found: usize,
    },
    /// A number of an activated Gaussian is NaN or infinite.
    #[error("{what}: Gaussian {gaussian} holds {found}, expected finite numbers")]
    NotFinite {
        /// Field of [`Activated`](crate::Activated).
        what: &'static str,
        /// Which Gaussian.
        gaussian: usize,
        /// The number.
        found: f32,
    },
    /// A standard deviation of 0 or below.
    #[error(
        "scales: Gaussian {gaussian} has {found}, expected numbers above 0: scales are standard deviations, not their logarithms"
    )]
    Scale {
        /// Which Gaussian.
        gaussian: usize,
        /// The number.
        found: f32,
    },
    /// An opacity outside 0 to 1.
    #[error(
        "opacities: Gaussian {gaussian} has {found}, expected 0 to 1: opacities are no logits, apply the sigmoid first"
    )]
    Opacity {
        /// Which Gaussian.
        gaussian: usize,
        /// The number.
        found: f32,
    },
    /// A quaternion without a direction.
    #[error("quats: Gaussian {gaussian} has a quaternion of norm 0, which is no rotation")]
    Quaternion {
        /// Which Gaussian.
        gaussian: usize,
    },
    /// There are not as many sets of pixel gradients as views.
    #[error("{found} sets of pixel gradients for {expected} views")]
    Views {
        /// Views recorded.
        expected: usize,
        /// Sets given.
        found: usize,
    },
    /// A plane of pixel gradients does not have the size of the view.
    #[error("the pixel gradients by {what} are {found} numbers, expected {expected}")]
    PixelGradientLength {
        /// Field of [`PixelGradients`](crate::PixelGradients), or the values that are weighted by shares.
        what: &'static str,
        /// Numbers expected.
        expected: usize,
        /// Numbers found.
        found: usize,
    },
    /// A pixel gradient is NaN or infinite.
    #[error("the pixel gradient by {what} number {index} is not finite")]
    PixelGradientNotFinite {
        /// Field of [`PixelGradients`](crate::PixelGradients).
        what: &'static str,
        /// Where.
        index: usize,
    },
    /// Ellipsoids have no gradients.
    #[error("only blended views have gradients, not those of ellipsoids")]
    NotBlended,
    /// A gradient by depth is given, but depth was not rendered.
    #[error("a gradient by depth needs a view that was rendered with depth")]
    DepthNotRendered,
    /// The tape was recorded on another device.
    #[error("the tape was recorded on another device than this rasterizer's")]
    OtherDevice,
    /// Shares are summed on the CPU only.
    #[cfg(feature = "gpu")]
    #[error("shares of Gaussians in pixels are summed on the CPU only; use `Rasterizer::cpu`")]
    SharesOnGpu,
    /// No adapter comes into question.
    #[error("no GPU to render on, found {found}; the CPU path needs none")]
    NoAdapter {
        /// What there is.
        found: String,
    },
    /// The adapter does not start.
    #[cfg(feature = "gpu")]
    #[error("the adapter {adapter} does not start")]
    Device {
        /// Name of the adapter.
        adapter: String,
        /// Why.
        source: Box<wgpu::RequestDeviceError>,
    },
    /// The adapter renders other than it should.
    #[cfg(feature = "gpu")]
    #[error(
        "the adapter {adapter} fails the self-test: {output} is off by {found:e}, {allowed:e} allowed; update its \
         driver or render on the CPU"
    )]
    SelfTest {
        /// Name of the adapter.
        adapter: String,
        /// What it got wrong.
        output: &'static str,
        /// Largest deviation.
        found: f32,
        /// Largest deviation allowed.
        allowed: f32,
    },
    /// The scene or the picture is too large for the adapter.
    #[cfg(feature = "gpu")]
    #[error(
        "the {what} of this scene takes {bytes} bytes, the adapter binds {limit}: render fewer Gaussians, a lower SH \
         degree or a smaller image, or render on the CPU"
    )]
    TooLargeForGpu {
        /// Which buffer.
        what: &'static str,
        /// Its size.
        bytes: u64,
        /// The largest size.
        limit: u64,
    },
    /// A side of the picture is more tiles than a dispatch may have workgroups.
    #[cfg(feature = "gpu")]
    #[error(
        "a side of the image is {found} pixels, the GPU draws at most {limit}: render a smaller image, or on the CPU"
    )]
    ImageTooLongForGpu {
        /// Pixels of the longer side.
        found: usize,
        /// The most.
        limit: usize,
    },
    /// The adapter failed.
    #[cfg(feature = "gpu")]
    #[error(
        "the adapter {adapter} failed; if it is short of memory, render a smaller scene, else on the CPU"
    )]
    Gpu {
        /// Name of the adapter.
        adapter: String,
        /// Why.
        source: Box<wgpu::Error>,
    },
    /// The adapter was lost.
    #[cfg(feature = "gpu")]
    #[error("the adapter {adapter} was lost while it worked; render on the CPU, or a smaller scene")]
    DeviceLost {
        /// Name of the adapter.
        adapter: String,
    },
    /// The picture could not be made.
    #[error(transparent)]
    Scene(#[from] gs_scene::Error),
}

/// The result of this crate's operations.
pub type Result<T> = std::result::Result<T, Error>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_say_what_was_expected() {
        let setting = Error::Setting { name: "near", found: -1.0, expected: "a finite number of at least 0" };
        assert_eq!(setting.to_string(), "render setting near is -1, expected a finite number of at least 0");
        let many = Error::TooManyIntersections { found: 5, limit: 4 };
        assert_eq!(
            many.to_string(),
            "the Gaussians touch 5 tiles in all, more than 4: render fewer or smaller Gaussians, or a smaller image"
        );
    }
}
