//! Meshes in PLY files (Stanford polygon format): ASCII, and binary of either byte order.

use super::polygons::Triangles;
use super::read::{FileError, Unused};
use crate::MeshRule;
use crate::texture::linear;
use glam::{DVec2, DVec3, Vec3};
use gs_scene::{PlyElement, PlyEncoding, PlyHeader, PlyKind, PlyProperty, PlyScalar};
use std::io::BufRead;

/// The longest word of an ASCII file; a number has some twenty letters.
const LONGEST_WORD: usize = 64;
/// The most corners of a polygon.
const MOST_CORNERS: f64 = 65_536.0;

/// Reads triangles from a file of this size in bytes.
///
/// Of the vertices, x, y, z, red, green, blue and one pair of s t, u v, texture_u texture_v is used; of the faces
/// vertex_indices or vertex_index. Everything else is passed over by its declared type.
pub(super) fn read_ply(
    reader: &mut impl BufRead,
    size: u64,
    unused: &mut Unused,
) -> Result<Triangles, FileError> {
    let header = PlyHeader::read(reader)?.map_err(MeshRule::Ply)?;
    let promised: u128 = header.elements.iter().map(|element| least_bytes(element, header.encoding)).sum();
    let found = size.saturating_sub(header.bytes);
    // The last word of an ASCII file needs no space behind it.
    if promised > u128::from(found) + u128::from(header.encoding == PlyEncoding::Ascii) {
        let promised = u64::try_from(promised).unwrap_or(u64::MAX);
        return Err(MeshRule::PlySize { promised, found }.into());
    }
    let mut values = Values { reader, encoding: header.encoding };
    let (mut triangles, mut has_vertices, mut has_faces) = (Triangles::default(), false, false);
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => {
                values.vertices(element, &mut triangles)?;
                has_vertices = true;
            }
            "face" if !has_vertices => {
                return Err(MeshRule::PlyMissing { what: "an element vertex before the faces" }.into());
            }
            "face" => {
                values.faces(element, &mut triangles)?;
                has_faces = true;
            }
            _ => {
                values.pass(element)?;
                unused.elements += element.count;
            }
        }
    }
    if !has_vertices || !has_faces {
        let what = if has_vertices { "an element face" } else { "an element vertex" };
        return Err(MeshRule::PlyMissing { what }.into());
    }
    unused.bytes += values.rest()?;
    Ok(triangles)
}

/// Where a vertex property goes.
#[derive(Clone, Copy)]
enum Use {
    Position(usize),
    /// A channel, and the number of which it is a share.
    Colour(usize, f64),
    Coordinate(usize),
}

/// Finds the columns with these names.
fn columns<const N: usize>(properties: &[PlyProperty], names: [&str; N]) -> Option<[usize; N]> {
    let found = names.map(|name| properties.iter().position(|property| property.name == name));
    found.iter().all(Option::is_some).then(|| found.map(Option::unwrap_or_default))
}

/// What is done with each column of the vertices.
fn uses(properties: &[PlyProperty]) -> Result<Vec<Option<Use>>, MeshRule> {
    let mut uses = vec![None; properties.len()];
    let position = columns(properties, ["x", "y", "z"])
        .ok_or(MeshRule::PlyMissing { what: "vertex properties x, y, z" })?;
    position.into_iter().enumerate().for_each(|(k, column)| uses[column] = Some(Use::Position(k)));
    for (k, column) in columns(properties, ["red", "green", "blue"]).into_iter().flatten().enumerate() {
        let PlyKind::Scalar(scalar) = properties[column].kind else { continue };
        uses[column] = Some(Use::Colour(k, full(scalar)));
    }
    let pairs = [["s", "t"], ["u", "v"], ["texture_u", "texture_v"]];
    if let Some(pair) = pairs.into_iter().find_map(|names| columns(properties, names)) {
        pair.into_iter().enumerate().for_each(|(k, column)| uses[column] = Some(Use::Coordinate(k)));
    }
    for (property, used) in properties.iter().zip(&uses) {
        if used.is_some() && matches!(property.kind, PlyKind::List(..)) {
            return Err(MeshRule::PlyList { name: property.name.clone() });
        }
    }
    Ok(uses)
}

/// The fewest bytes that an element can take: lists may be empty, and a word needs a space.
fn least_bytes(element: &PlyElement, encoding: PlyEncoding) -> u128 {
    let least = |property: &PlyProperty| match (encoding, property.kind) {
        (PlyEncoding::Ascii, _) => 2,
        (_, PlyKind::Scalar(scalar) | PlyKind::List(scalar, _)) => scalar.size() as u128,
    };
    u128::from(element.count) * element.properties.iter().map(least).sum::<u128>()
}

/// The number of which a colour channel is a share: the largest of an integer type, 1 for the others.
fn full(scalar: PlyScalar) -> f64 {
    match scalar {
        PlyScalar::I8 => i8::MAX.into(),
        PlyScalar::U8 => u8::MAX.into(),
        PlyScalar::I16 => i16::MAX.into(),
        PlyScalar::U16 => u16::MAX.into(),
        PlyScalar::I32 => i32::MAX.into(),
        PlyScalar::U32 => u32::MAX.into(),
        PlyScalar::F32 | PlyScalar::F64 => 1.0,
    }
}

/// The numbers of a file, one after the other.
struct Values<'a, R> {
    reader: &'a mut R,
    encoding: PlyEncoding,
}

/// Why there is no next number.
enum Stop {
    End,
    Word(String),
    Io(std::io::Error),
}

impl From<std::io::Error> for Stop {
    fn from(error: std::io::Error) -> Self {
        if error.kind() == std::io::ErrorKind::UnexpectedEof { Self::End } else { Self::Io(error) }
    }
}

impl Stop {
    /// The error, if it happened in this element.
    fn within(self, element: &PlyElement, index: u64) -> FileError {
        let name = element.name.clone();
        match self {
            Self::End => {
                MeshRule::PlyTruncated { element: name, promised: element.count, found: index }.into()
            }
            Self::Word(found) => MeshRule::PlyNumber { element: name, index, found }.into(),
            Self::Io(error) => error.into(),
        }
    }
}

impl<R: BufRead> Values<'_, R> {
    #[inline]
    fn next(&mut self, scalar: PlyScalar) -> Result<f64, Stop> {
        if self.encoding == PlyEncoding::Ascii {
            return self.next_word(scalar);
        }
        let mut bytes = [0; 8];
        let size = scalar.size();
        self.reader.read_exact(&mut bytes[..size])?;
        if self.encoding == PlyEncoding::BigEndian {
            bytes[..size].reverse();
        }
        Ok(scalar.decode(bytes))
    }

    fn next_word(&mut self, scalar: PlyScalar) -> Result<f64, Stop> {
        let mut word = Vec::with_capacity(24);
        loop {
            let buffer = self.reader.fill_buf()?;
            if buffer.is_empty() {
                break;
            }
            let blank = if word.is_empty() {
                buffer.iter().take_while(|b| b.is_ascii_whitespace()).count()
            } else {
                0
            };
            let letters = buffer[blank..].iter().take_while(|b| !b.is_ascii_whitespace()).count();
            let (taken, ends) = (blank + letters, blank + letters < buffer.len());
            word.extend_from_slice(&buffer[blank..taken][..letters.min(LONGEST_WORD)]);
            self.reader.consume(taken);
            if word.len() >= LONGEST_WORD || (ends && !word.is_empty()) {
                break;
            }
        }
        if word.is_empty() {
            return Err(Stop::End);
        }
        let value = std::str::from_utf8(&word).ok().and_then(|word| word.parse::<f64>().ok());
        let value = value.filter(|value| !scalar.is_integer() || value.fract() == 0.0);
        value.ok_or_else(|| Stop::Word(String::from_utf8_lossy(&word).into_owned()))
    }

    fn vertices(&mut self, element: &PlyElement, triangles: &mut Triangles) -> Result<(), FileError> {
        let uses = uses(&element.properties)?;
        let has = |wanted: fn(&Use) -> bool| uses.iter().flatten().any(wanted);
        let (coloured, mapped) =
            (has(|u| matches!(u, Use::Colour(..))), has(|u| matches!(u, Use::Coordinate(_))));
        // The header has been held against the size of the file.
        let count = usize::try_from(element.count).unwrap_or(usize::MAX);
        triangles.vertices.reserve_exact(count);
        triangles.colours.reserve_exact(if coloured { count } else { 0 });
        triangles.coordinates.reserve_exact(if mapped { count } else { 0 });
        let bytes: [Vec3; 256] = std::array::from_fn(|k| linear([k as f32 / 255.0; 3]));
        for vertex in 0..element.count {
            let (mut position, mut colour, mut coordinate) = (DVec3::ZERO, Vec3::ZERO, DVec2::ZERO);
            for (property, used) in element.properties.iter().zip(&uses) {
                let PlyKind::Scalar(scalar) = property.kind else {
                    self.pass_property(property).map_err(|stop| stop.within(element, vertex))?;
                    continue;
                };
                let value = self.next(scalar).map_err(|stop| stop.within(element, vertex))?;
                match *used {
                    Some(Use::Position(k)) => position[k] = value,
                    Some(Use::Coordinate(k)) => coordinate[k] = value,
                    Some(Use::Colour(k, full)) => {
                        let share = value / full;
                        if !(0.0..=1.0).contains(&share) {
                            return Err(MeshRule::Colour { vertex, found: share.to_string() }.into());
                        }
                        colour[k] =
                            if full == 255.0 { bytes[value as usize].x } else { linear([share as f32; 3]).x };
                    }
                    None => {}
                }
            }
            triangles.vertices.push(position);
            if coloured {
                triangles.colours.push(colour);
            }
            if mapped {
                triangles.coordinates.push(coordinate);
            }
        }
        Ok(())
    }

    fn faces(&mut self, element: &PlyElement, triangles: &mut Triangles) -> Result<(), FileError> {
        let is_indices =
            |property: &&PlyProperty| ["vertex_indices", "vertex_index"].contains(&property.name.as_str());
        let indices = element.properties.iter().find(is_indices);
        let Some(PlyKind::List(_, item)) = indices.map(|property| property.kind).filter(|kind| match kind {
            PlyKind::List(_, item) => item.is_integer(),
            PlyKind::Scalar(_) => false,
        }) else {
            return Err(
                MeshRule::PlyMissing { what: "a face property vertex_indices, a list of integers" }.into()
            );
        };
        let vertices = triangles.vertices.len() as u64;
        triangles.faces.reserve(usize::try_from(element.count).unwrap_or(usize::MAX));
        let mut corners = Vec::new();
        for face in 0..element.count {
            for property in &element.properties {
                match property.kind {
                    PlyKind::List(length, _) if is_indices(&property) => {
                        let count = self.next(length).map_err(|stop| stop.within(element, face))?;
                        if !(3.0..=MOST_CORNERS).contains(&count) {
                            return Err(MeshRule::PlyLength { face, found: count as i64 }.into());
                        }
                        corners.clear();
                        for _ in 0..count as u32 {
                            let index = self.next(item).map_err(|stop| stop.within(element, face))?;
                            if index < 0.0 || index >= vertices as f64 {
                                return Err(
                                    MeshRule::FaceIndex { face, found: index as i64, vertices }.into()
                                );
                            }
                            corners.push(index as u32);
                        }
                        triangles.push_polygon(&corners)?;
                    }
                    _ => self.pass_property(property).map_err(|stop| stop.within(element, face))?,
                }
            }
        }
        Ok(())
    }

    /// Passes over an element that is not used.
    fn pass(&mut self, element: &PlyElement) -> Result<(), FileError> {
        // Nothing is written for an element without properties, however many there are.
        let count = if element.properties.is_empty() { 0 } else { element.count };
        for index in 0..count {
            for property in &element.properties {
                self.pass_property(property).map_err(|stop| stop.within(element, index))?;
            }
        }
        Ok(())
    }

    fn pass_property(&mut self, property: &PlyProperty) -> Result<(), Stop> {
        match property.kind {
            PlyKind::Scalar(scalar) => self.next(scalar).map(|_| ()),
            PlyKind::List(length, item) => {
                let count = self.next(length)?;
                if count < 0.0 {
                    return Err(Stop::Word(format!("a list of {count}")));
                }
                (0..count as u64).try_for_each(|_| self.next(item).map(|_| ()))
            }
        }
    }

    /// How many bytes follow, spaces of an ASCII file apart.
    fn rest(&mut self) -> std::io::Result<u64> {
        let mut count = 0;
        loop {
            let buffer = self.reader.fill_buf()?;
            if buffer.is_empty() {
                return Ok(count);
            }
            let blank = |byte: &&u8| self.encoding == PlyEncoding::Ascii && byte.is_ascii_whitespace();
            count += (buffer.len() - buffer.iter().filter(blank).count()) as u64;
            let taken = buffer.len();
            self.reader.consume(taken);
        }
    }
}
