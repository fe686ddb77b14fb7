//! Rooms of the Replica data set in its original release, as scenes.

use crate::check::Place;
use crate::{Error, Finish, Material, Mesh, MeshSource, Pattern, Result, Rgb, Scene, Sky};
use glam::DVec3;
use serde::Deserialize;
use std::path::Path;

/// How far the official viewer lifts a mirror or pane off its plane, towards the plane's normal, metres: the scan has
/// a surface there too.
const LIFT: f64 = 0.0025;
/// Reflectances up to this are glass: what a pane reflects whose index of refraction is 3.
const MOST_OF_GLASS: f64 = 0.4;

/// An entry of `glass.sur`; its other fields say the same in coordinates of the plane.
#[derive(Deserialize)]
struct Surface {
    /// Normal and offset: the plane is where `n·p + d = 0`.
    plane_w: [f64; 4],
    /// The outline, metres.
    boundary_w: Vec<[f64; 3]>,
    /// Share of the light that is reflected at a right angle, 0 to 1.
    reflectivity: f64,
}

/// A scene from a folder of the Replica data set: `mesh.ply` with its vertex colours, shown as they are, and the
/// mirrors and panes of `glass.sur` if there is one. Make it ready with [`crate::Traced::load`] and the same folder.
///
/// # Errors
/// If there is no `mesh.ply`, or `glass.sur` cannot be read or holds a number out of its range; the error names the
/// file, the surface and the field.
pub fn replica_scene(folder: &Path) -> Result<Scene> {
    let mesh = folder.join("mesh.ply");
    std::fs::metadata(&mesh).map_err(|source| Error::Io { action: "read", path: mesh, source })?;
    let material = Material { pattern: Pattern::VertexColours, mottle: 0.0, seed: 0, finish: Finish::Baked };
    let black = Sky { zenith: [0.0; 3], horizon: [0.0; 3], ground: [0.0; 3], light: 0.0, occlusion: None };
    let mut meshes = vec![mesh_of("scan".into(), MeshSource::File("mesh.ply".into()), material)];
    let path = folder.join("glass.sur");
    match std::fs::read(&path) {
        Ok(bytes) => meshes.extend(surfaces(&bytes, &path)?),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
        Err(source) => return Err(Error::Io { action: "read", path, source }),
    }
    Ok(Scene { meshes, ..Scene::under(black) })
}

fn mesh_of(name: String, source: MeshSource, material: Material) -> Mesh {
    Mesh { name, source, centre: DVec3::ZERO, rotation: DVec3::ZERO, scale: 1.0, material }
}

fn surfaces(bytes: &[u8], path: &Path) -> Result<Vec<Mesh>> {
    let surfaces: Vec<Surface> = serde_json::from_slice(bytes)
        .map_err(|source| Error::GlassSur { path: path.to_path_buf(), source: Box::new(source) })?;
    surfaces.iter().enumerate().map(|(index, surface)| surface.mesh(index, path)).collect()
}

impl Surface {
    fn mesh(&self, index: usize, path: &Path) -> Result<Mesh> {
        let name = || format!("{}: surface {index}", path.display());
        let place = Place::new(&name);
        let [a, b, c, offset] = self.plane_w;
        let normal = DVec3::new(a, b, c);
        place.point("plane_w", normal)?;
        place.point("plane_w", DVec3::splat(offset))?;
        let length = normal.length();
        place.rule(length > 1e-6, "length of the normal in plane_w", length, "more than 1e-6")?;
        let reflectivity = self.reflectivity;
        place.rule((0.0..=1.0).contains(&reflectivity), "reflectivity", reflectivity, "0 to 1")?;
        let corners = self.boundary_w.len();
        place.rule(corners >= 3, "number of points in boundary_w", corners as f64, "3 or more")?;
        let (normal, offset) = (normal / length, offset / length);
        let lifted = |point: &[f64; 3]| {
            let point = DVec3::from(*point);
            place.point("boundary_w", point)?;
            Ok(point + normal * (LIFT - offset - normal.dot(point)))
        };
        let vertices = self.boundary_w.iter().map(lifted).collect::<Result<Vec<_>>>()?;
        let source =
            MeshSource::Inline { vertices, faces: vec![(0..corners as u32).collect()], colours: Vec::new() };
        let (kind, colour, finish) = if reflectivity <= MOST_OF_GLASS {
            // A pane reflects 2 r / (1 + r) at a right angle, if each side reflects r = ((index - 1) / (index + 1))².
            let root = (reflectivity / (2.0 - reflectivity)).sqrt();
            ("pane", [1.0; 3], Finish::Glass { index: ((1.0 + root) / (1.0 - root)).clamp(1.0, 3.0) })
        } else {
            ("mirror", encoded(reflectivity), Finish::Mirror)
        };
        let material = Material { pattern: Pattern::Plain { colour }, mottle: 0.0, seed: 0, finish };
        Ok(mesh_of(format!("{kind} {index}"), source, material))
    }
}

/// The grey that reflects this share of the light.
fn encoded(share: f64) -> Rgb {
    crate::texture::encode(glam::Vec3::splat(share as f32))
}
