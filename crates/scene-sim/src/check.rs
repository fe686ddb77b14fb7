//! The rules that a description must keep, each with an error that names the place.

use crate::check_lights::check_lights;
use crate::{
    Error, Material, Mesh, MeshSource, Pattern, Photographs, Primitive, Result, Rgb, SCENE_VERSION, Scene,
    Shape,
};
use glam::DVec3;

/// Beyond this magnitude (metres) f64 no longer resolves a tenth of a micrometre.
pub(crate) const FARTHEST: f64 = 1e9;

/// Checks the numbers of one place of a scene.
pub(crate) struct Place<'a> {
    name: &'a dyn Fn() -> String,
}

impl<'a> Place<'a> {
    pub(crate) fn new(name: &'a dyn Fn() -> String) -> Self {
        Self { name }
    }

    pub(crate) fn rule(
        &self,
        holds: bool,
        field: &'static str,
        found: f64,
        expected: &'static str,
    ) -> Result<()> {
        if holds {
            return Ok(());
        }
        let place = (self.name)();
        Err(Error::Value { place, field, found, expected })
    }

    pub(crate) fn point(&self, field: &'static str, value: DVec3) -> Result<()> {
        value.to_array().into_iter().try_for_each(|v| {
            self.rule(v.abs() <= FARTHEST, field, v, "finite numbers of magnitude up to 1e9")
        })
    }

    /// A length that may be 0.
    pub(crate) fn extent(&self, field: &'static str, value: f64) -> Result<()> {
        self.rule((0.0..=FARTHEST).contains(&value), field, value, "0 to 1e9")
    }

    /// A length that a pattern divides by.
    pub(crate) fn period(&self, field: &'static str, value: f64) -> Result<()> {
        self.rule((1e-6..=FARTHEST).contains(&value), field, value, "1e-6 to 1e9")
    }

    pub(crate) fn share(&self, field: &'static str, value: f32) -> Result<()> {
        self.rule((0.0..=1.0).contains(&value), field, value.into(), "0 to 1")
    }

    pub(crate) fn strength(&self, field: &'static str, value: f32) -> Result<()> {
        self.rule((0.0..=1e6).contains(&value), field, value.into(), "0 to 1e6")
    }

    pub(crate) fn colour(&self, field: &'static str, colour: Rgb) -> Result<()> {
        colour.into_iter().try_for_each(|channel| self.share(field, channel))
    }

    fn shape(&self, shape: &Shape) -> Result<()> {
        match *shape {
            Shape::Rectangle { width, height } => {
                self.extent("width", width)?;
                self.extent("height", height)
            }
            Shape::Box { size } => size.to_array().into_iter().try_for_each(|v| self.extent("size", v)),
            Shape::Sphere { radius } => self.extent("radius", radius),
            Shape::Cylinder { radius, height } => {
                self.extent("radius", radius)?;
                self.extent("height", height)
            }
        }
    }

    fn pattern(&self, pattern: &Pattern) -> Result<()> {
        match *pattern {
            Pattern::Plain { colour } => self.colour("colour", colour),
            Pattern::Checker { colours, cell } => {
                colours.into_iter().try_for_each(|colour| self.colour("colours", colour))?;
                self.period("cell", cell)
            }
            Pattern::Brick { brick, mortar, length, height, joint } => {
                self.colour("brick", brick)?;
                self.colour("mortar", mortar)?;
                self.period("length", length)?;
                self.period("height", height)?;
                self.extent("joint", joint)
            }
            Pattern::Wood { light, dark, plank } => {
                self.colour("light", light)?;
                self.colour("dark", dark)?;
                self.period("plank", plank)
            }
            Pattern::Noise { dark, light, scale, octaves } => {
                self.colour("dark", dark)?;
                self.colour("light", light)?;
                self.period("scale", scale)?;
                self.rule((1..=12).contains(&octaves), "octaves", octaves.into(), "1 to 12")
            }
            Pattern::Foliage { dark, light, leaf, cover } => {
                self.colour("dark", dark)?;
                self.colour("light", light)?;
                self.period("leaf", leaf)?;
                self.share("cover", cover)
            }
            Pattern::VertexColours => Ok(()),
            Pattern::Print { paper, ink, accent, line } => {
                self.colour("paper", paper)?;
                self.colour("ink", ink)?;
                self.colour("accent", accent)?;
                self.period("line", line)
            }
        }
    }

    fn primitive(&self, primitive: &Primitive) -> Result<()> {
        self.shape(&primitive.shape)?;
        self.point("centre", primitive.centre)?;
        self.point("rotation", primitive.rotation)?;
        self.material(&primitive.material)
    }

    fn material(&self, material: &Material) -> Result<()> {
        self.share("mottle", material.mottle)?;
        self.finish(material.finish)?;
        self.pattern(&material.pattern)
    }

    fn mesh(&self, mesh: &Mesh) -> Result<()> {
        self.point("centre", mesh.centre)?;
        self.point("rotation", mesh.rotation)?;
        self.period("scale", mesh.scale)?;
        self.material(&mesh.material)?;
        let MeshSource::Inline { vertices, colours, .. } = &mesh.source else { return Ok(()) };
        vertices.iter().try_for_each(|vertex| self.point("vertices", *vertex * mesh.scale))?;
        colours.iter().try_for_each(|colour| self.colour("colours", *colour))
    }
}

/// Checks the version and every number of a scene.
pub(crate) fn check(scene: &Scene) -> Result<()> {
    if scene.version != SCENE_VERSION {
        return Err(Error::Version { found: scene.version, expected: SCENE_VERSION });
    }
    for (index, primitive) in scene.primitives.iter().enumerate() {
        Place::new(&|| format!("primitive {index} ({})", primitive.name)).primitive(primitive)?;
    }
    for (index, mesh) in scene.meshes.iter().enumerate() {
        Place::new(&|| format!("mesh {index} ({})", mesh.name)).mesh(mesh)?;
    }
    check_lights(scene)?;
    scene.photographs.as_ref().map_or(Ok(()), Photographs::check)
}
