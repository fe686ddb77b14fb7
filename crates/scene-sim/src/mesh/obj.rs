//! Meshes in Wavefront OBJ files: vertices with optional colours, texture coordinates, polygons.

use super::polygons::Triangles;
use super::read::{FileError, Unused};
use crate::MeshRule;
use crate::texture::linear;
use glam::{DVec2, DVec3};
use std::collections::HashMap;
use std::io::{BufRead, Read};

/// The longest line with its continuations, bytes.
const LONGEST_LINE: usize = 1 << 20;

/// What has been read so far.
#[derive(Default)]
struct Obj {
    triangles: Triangles,
    /// For each vertex of the file, its number among the triangles' vertices. A vertex with two texture coordinates
    /// is two vertices there, in one place.
    numbers: Vec<u32>,
    coordinates: Vec<DVec2>,
    /// For each of the triangles' vertices the texture coordinate that it has taken on, if any.
    taken: Vec<Option<u32>>,
    /// Later texture coordinates of a vertex, each with a vertex of its own.
    seams: HashMap<(u32, u32), u32>,
    corners: Vec<u32>,
    without_coordinates: u64,
    with_coordinates: u64,
}

/// Reads triangles. Materials, groups, smoothing and normals do not matter to a mesh with one material and flat
/// faces.
pub(super) fn read_obj(reader: &mut impl BufRead, unused: &mut Unused) -> Result<Triangles, FileError> {
    let (mut obj, mut line, mut number) = (Obj::default(), Vec::new(), 0);
    loop {
        let first = number + 1;
        let count = read_line(reader, &mut line, first)?;
        if count == 0 {
            break;
        }
        number += count;
        obj.line(&String::from_utf8_lossy(&line), first, unused)?;
    }
    let Obj { mut triangles, taken, coordinates, .. } = obj;
    if obj.with_coordinates > 0 && obj.without_coordinates > 0 {
        unused.coordinates += obj.without_coordinates;
    } else if obj.with_coordinates > 0 {
        let coordinate = |taken: &Option<u32>| taken.map_or(DVec2::ZERO, |index| coordinates[index as usize]);
        triangles.coordinates = taken.iter().map(coordinate).collect();
    }
    let (found, vertices) = (triangles.colours.len() as u64, triangles.vertices.len() as u64);
    if found != 0 && found != vertices {
        return Err(MeshRule::Colours { found, vertices }.into());
    }
    Ok(triangles)
}

/// Reads a line with its continuations and says how many lines they were; 0 at the end of the file.
fn read_line(reader: &mut impl BufRead, line: &mut Vec<u8>, number: u64) -> Result<u64, FileError> {
    line.clear();
    for count in 1.. {
        let room = (LONGEST_LINE - line.len()) as u64;
        let got = reader.take(room).read_until(b'\n', line)? as u64;
        if got == room {
            return Err(MeshRule::ObjLong { line: number }.into());
        }
        if got == 0 {
            return Ok(count - 1);
        }
        while line.last().is_some_and(u8::is_ascii_whitespace) {
            line.pop();
        }
        if line.last() != Some(&b'\\') {
            return Ok(count);
        }
        line.pop();
        line.push(b' ');
    }
    Ok(0)
}

impl Obj {
    fn line(&mut self, text: &str, line: u64, unused: &mut Unused) -> Result<(), FileError> {
        let text = text.split('#').next().unwrap_or_default();
        let mut words = text.split_ascii_whitespace();
        match words.next() {
            Some("v") => self.vertex(words, line)?,
            Some("vt") => {
                let (numbers, count) = numbers::<3>(words, line)?;
                if count == 0 {
                    return Err(MeshRule::ObjCount { line, found: 0, expected: "1 to 3" }.into());
                }
                self.coordinates.push(DVec2::new(numbers[0], numbers[1]));
            }
            Some("f") => self.face(words, line)?,
            None | Some("vn" | "g" | "o" | "s") => {}
            Some("mtllib" | "usemtl") => unused.materials += 1,
            Some(_) => unused.lines += 1,
        }
        Ok(())
    }

    fn vertex<'a>(&mut self, words: impl Iterator<Item = &'a str>, line: u64) -> Result<(), FileError> {
        let (numbers, count) = numbers::<7>(words, line)?;
        // A fourth number is the weight of rational curves, which a polygon does not have.
        let colour = match count {
            3 | 4 => None,
            6 => Some([numbers[3], numbers[4], numbers[5]]),
            7 => Some([numbers[4], numbers[5], numbers[6]]),
            _ => {
                return Err(MeshRule::ObjCount { line, found: count as u64, expected: "3, 4, 6 or 7" }.into());
            }
        };
        let vertex = self.numbers.len() as u64;
        if vertex >= u64::from(u32::MAX) {
            return Err(MeshRule::TooMany { found: vertex + 1 }.into());
        }
        self.numbers.push(self.triangles.vertices.len() as u32);
        self.triangles.vertices.push(DVec3::new(numbers[0], numbers[1], numbers[2]));
        self.taken.push(None);
        if let Some(colour) = colour {
            if let Some(found) = colour.iter().find(|channel| !(0.0..=1.0).contains(*channel)) {
                return Err(MeshRule::Colour { vertex, found: found.to_string() }.into());
            }
            self.triangles.colours.push(linear(colour.map(|channel| channel as f32)));
        }
        Ok(())
    }

    fn face<'a>(&mut self, words: impl Iterator<Item = &'a str>, line: u64) -> Result<(), FileError> {
        let mut corners = std::mem::take(&mut self.corners);
        corners.clear();
        for word in words {
            let mut parts = word.split('/');
            let vertex = index(parts.next().unwrap_or_default(), self.numbers.len(), line)?;
            let coordinate = match parts.next() {
                None | Some("") => None,
                Some(part) => Some(index(part, self.coordinates.len(), line)?),
            };
            corners.push(self.corner(vertex, coordinate)?);
        }
        self.triangles.push_polygon(&corners)?;
        self.corners = corners;
        Ok(())
    }

    /// The number of the vertex that has this texture coordinate.
    fn corner(&mut self, vertex: u32, coordinate: Option<u32>) -> Result<u32, FileError> {
        let number = self.numbers[vertex as usize];
        let Some(coordinate) = coordinate else {
            self.without_coordinates += 1;
            return Ok(number);
        };
        self.with_coordinates += 1;
        let taken = &mut self.taken[number as usize];
        if *taken.get_or_insert(coordinate) == coordinate {
            return Ok(number);
        }
        let next = self.triangles.vertices.len() as u64;
        let twin = *self.seams.entry((vertex, coordinate)).or_insert(next as u32);
        if u64::from(twin) == next {
            if next >= u64::from(u32::MAX) {
                return Err(MeshRule::TooMany { found: next + 1 }.into());
            }
            self.triangles.vertices.push(self.triangles.vertices[number as usize]);
            if let Some(colour) = self.triangles.colours.get(number as usize).copied() {
                self.triangles.colours.push(colour);
            }
            self.taken.push(Some(coordinate));
        }
        Ok(twin)
    }
}

/// Up to `N` numbers of a line, and how many words there are.
fn numbers<'a, const N: usize>(
    words: impl Iterator<Item = &'a str>,
    line: u64,
) -> Result<([f64; N], usize), MeshRule> {
    let (mut numbers, mut count) = ([0.0; N], 0);
    for word in words {
        let number = word.parse().map_err(|_| MeshRule::ObjNumber { line, found: word.to_owned() })?;
        if let Some(slot) = numbers.get_mut(count) {
            *slot = number;
        }
        count += 1;
    }
    Ok((numbers, count))
}

/// An index from 0: of the file's from 1, or of those from -1 backwards.
fn index(word: &str, count: usize, line: u64) -> Result<u32, MeshRule> {
    let found: i64 = word.parse().map_err(|_| MeshRule::ObjNumber { line, found: word.to_owned() })?;
    let index = if found < 0 { found + count as i64 } else { found - 1 };
    u32::try_from(index).ok().filter(|index| (*index as usize) < count).ok_or(MeshRule::ObjIndex {
        line,
        found,
        count: count as u64,
    })
}
