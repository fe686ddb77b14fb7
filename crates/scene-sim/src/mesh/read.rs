//! Where the triangles of a mesh come from.

use super::polygons::Triangles;
use crate::texture::linear;
use crate::trace::Dropped;
use crate::{Error, Mesh, MeshRule, MeshSource, Result};
use std::path::Path;

/// The triangles of a mesh in its own units; what of its file is not used goes to `dropped`.
pub(crate) fn triangles_of(
    mesh: &Mesh,
    place: &str,
    folder: Option<&Path>,
    _dropped: &mut Vec<Dropped>,
) -> Result<Triangles> {
    match &mesh.source {
        MeshSource::Inline { vertices, faces, colours } => {
            let broken = |rule| Error::Polygons { place: place.to_owned(), rule };
            if !colours.is_empty() && colours.len() != vertices.len() {
                let rule = MeshRule::Colours { found: colours.len() as u64, vertices: vertices.len() as u64 };
                return Err(broken(rule));
            }
            let colours = colours.iter().map(|&colour| linear(colour)).collect();
            let mut triangles = Triangles { vertices: vertices.clone(), colours, ..Triangles::default() };
            faces.iter().try_for_each(|face| triangles.push_polygon(face)).map_err(broken)?;
            Ok(triangles)
        }
        MeshSource::File(_) => {
            let _folder = folder.ok_or_else(|| Error::NoFolder { place: place.to_owned() })?;
            Err(Error::NoFolder { place: place.to_owned() })
        }
    }
}
