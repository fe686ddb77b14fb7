//! Materials: patterns of colours, and what a surface does with light.

use serde::{Deserialize, Serialize};

/// A colour as people pick it: sRGB-encoded red, green and blue in 0..1. Light is computed on the linear
/// values.
pub type Rgb = [f32; 3];

/// How a surface looks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Its colours and their arrangement.
    pub pattern: Pattern,
    /// How strongly stains and wear vary the reflectance: 0 = clean, 1 = down to black.
    #[serde(default)]
    pub mottle: f32,
    /// Which of the endless variants of the pattern; two things with one seed look the same.
    #[serde(default)]
    pub seed: u32,
    /// What it does with light.
    #[serde(default)]
    pub finish: Finish,
}

/// What a surface does with light.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Finish {
    /// Scatters it alike to all sides (Lambert).
    #[default]
    Matte,
    /// Shows what is in front of it, times the pattern's colour. The depth of a picture is that of the mirror. After eight
    /// reflections and refractions a ray ends dark, and so does one that would add less than 1 %.
    Mirror,
    /// Lets light through, times the pattern's colour, and reflects a part of it (Fresnel). A rectangle, a plate without
    /// thickness or a mesh that is not closed is a thin pane that does not bend light; a closed shape or mesh does
    /// (Snell), and colours the light that enters it. Between two glasses in each other there is air. Glass casts no
    /// shadow and gathers no light; the depth of a picture is that of the glass. Rays end as those of mirrors do.
    Glass {
        /// Index of refraction, 1 to 3: 1.5 for window glass.
        index: f64,
    },
    /// Shown as it is, whatever shines on it: the colours of a scan already contain the light.
    Baked,
}

/// A procedural arrangement of colours on a surface, in metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Pattern {
    /// One colour: nothing for stereo to hold on to.
    Plain {
        /// The colour.
        colour: Rgb,
    },
    /// Squares of two colours in turn.
    Checker {
        /// The two colours.
        colours: [Rgb; 2],
        /// Edge of a square, metres.
        cell: f64,
    },
    /// Courses of bricks, each course shifted by half a brick, every brick a little different.
    Brick {
        /// Mean colour of the bricks.
        brick: Rgb,
        /// Colour of the joints.
        mortar: Rgb,
        /// Length of a brick with its joint, metres.
        length: f64,
        /// Height of a course with its joint, metres.
        height: f64,
        /// Width of a joint, metres.
        joint: f64,
    },
    /// Planks along x with grain.
    Wood {
        /// Early wood.
        light: Rgb,
        /// Late wood, the dark lines.
        dark: Rgb,
        /// Width of a plank, metres.
        plank: f64,
    },
    /// Value noise of several octaves: earth, leaves, concrete.
    Noise {
        /// Colour of the low values.
        dark: Rgb,
        /// Colour of the high values.
        light: Rgb,
        /// Wavelength of the coarsest octave, metres.
        scale: f64,
        /// Number of octaves, 1 to 12; each has half the wavelength and half the amplitude of the one before.
        octaves: u32,
    },
    /// A printed page on every face: a heading, lines of letters, a picture.
    Print {
        /// Colour of the page.
        paper: Rgb,
        /// Colour of the letters.
        ink: Rgb,
        /// Colour of the heading and the picture.
        accent: Rgb,
        /// Distance of two lines of text, metres.
        line: f64,
    },
    /// Leaves with holes between them, through which the eye and the light pass.
    Foliage {
        /// Colour of the shaded leaves.
        dark: Rgb,
        /// Colour of the lit leaves.
        light: Rgb,
        /// Length of a leaf, metres.
        leaf: f64,
        /// Share of the surface that leaves cover, 0 to 1.
        cover: f32,
    },
    /// The colours that a mesh brings with its vertices, interpolated; white where it brings none, or on a primitive.
    VertexColours,
}
