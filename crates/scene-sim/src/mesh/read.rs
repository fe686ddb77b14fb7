//! Sources of the triangles of a mesh.

use super::obj::read_obj;
use super::ply::read_ply;
use super::polygons::Triangles;
use crate::check::FARTHEST;
use crate::texture::linear;
use crate::trace::{Dropped, Omission};
use crate::{Error, Mesh, MeshRule, MeshSource, Result};
use glam::DVec2;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// What a file holds and a mesh has no use for.
#[derive(Debug, Default)]
pub(super) struct Unused {
    pub(super) materials: u64,
    pub(super) lines: u64,
    pub(super) coordinates: u64,
    pub(super) elements: u64,
    pub(super) bytes: u64,
}

/// Why a file is not read.
#[derive(Debug)]
pub(super) enum FileError {
    Rule(MeshRule),
    Io(std::io::Error),
}

impl From<MeshRule> for FileError {
    fn from(rule: MeshRule) -> Self {
        Self::Rule(rule)
    }
}

impl From<std::io::Error> for FileError {
    fn from(error: std::io::Error) -> Self {
        Self::Io(error)
    }
}

/// The triangles of a mesh in its own units; what of its file is not used goes to `dropped`.
pub(crate) fn triangles_of(
    mesh: &Mesh,
    place: &str,
    folder: Option<&Path>,
    dropped: &mut Vec<Dropped>,
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
        MeshSource::File(name) => {
            let folder = folder.ok_or_else(|| Error::NoFolder { place: place.to_owned() })?;
            read_file(&folder.join(name), mesh.scale, place, dropped)
        }
    }
}

fn read_file(path: &Path, scale: f64, place: &str, dropped: &mut Vec<Dropped>) -> Result<Triangles> {
    let io = |source| Error::Io { action: "read", path: path.to_path_buf(), source };
    let broken = |rule| Error::MeshFile { place: place.to_owned(), path: path.to_path_buf(), rule };
    let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    let file = File::open(path).map_err(io)?;
    let size = file.metadata().map_err(io)?.len();
    let (mut reader, mut unused) = (BufReader::with_capacity(1 << 20, file), Unused::default());
    let triangles = match extension.to_ascii_lowercase().as_str() {
        "ply" => read_ply(&mut reader, size, &mut unused),
        "obj" => read_obj(&mut reader, &mut unused),
        _ => Err(MeshRule::Extension { found: extension.to_owned() }.into()),
    };
    let triangles = triangles.map_err(|error| match error {
        FileError::Rule(rule) => broken(rule),
        FileError::Io(source) => io(source),
    })?;
    for (vertex, position) in triangles.vertices.iter().enumerate() {
        let farthest = (*position * scale).abs().to_array();
        if let Some(found) = farthest.iter().find(|coordinate| !(0.0..=FARTHEST).contains(*coordinate)) {
            return Err(broken(MeshRule::Vertex { vertex: vertex as u64, found: found.to_string() }));
        }
    }
    let is_near =
        |uv: &DVec2| uv.abs().to_array().iter().all(|coordinate| (0.0..=FARTHEST).contains(coordinate));
    if let Some(vertex) = triangles.coordinates.iter().position(|uv| !is_near(uv)) {
        return Err(broken(MeshRule::Coordinate { vertex: vertex as u64 }));
    }
    let Unused { materials, lines, coordinates, elements, bytes } = unused;
    for (what, count) in [
        (Omission::Materials, materials),
        (Omission::Lines, lines),
        (Omission::Coordinates, coordinates),
        (Omission::Elements, elements),
        (Omission::Bytes, bytes),
    ] {
        if count > 0 {
            dropped.push(Dropped { place: place.to_owned(), what, count });
        }
    }
    Ok(triangles)
}
