//! Points of a PLY file: position and colour of its vertices, whatever else they have; text or binary.

use crate::files::{Lines, broken, unreadable};
use crate::{Error, FormatRule, Place, Result, ScenePoint};
use glam::DVec3;
use std::io::Read;
use std::path::Path;

/// How the numbers of the body are written.
#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Text,
    Little,
    Big,
}

/// A type of numbers.
#[derive(Clone, Copy)]
enum Kind {
    Signed(usize),
    Unsigned(usize),
    Float(usize),
}

impl Kind {
    fn of(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::Signed(1),
            "short" | "int16" => Self::Signed(2),
            "int" | "int32" => Self::Signed(4),
            "uchar" | "uint8" => Self::Unsigned(1),
            "ushort" | "uint16" => Self::Unsigned(2),
            "uint" | "uint32" => Self::Unsigned(4),
            "float" | "float32" => Self::Float(4),
            "double" | "float64" => Self::Float(8),
            _ => return None,
        })
    }

    fn bytes(self) -> usize {
        match self {
            Self::Signed(bytes) | Self::Unsigned(bytes) | Self::Float(bytes) => bytes,
        }
    }

    /// A number from its bytes, the lowest first.
    fn number(self, bytes: &[u8]) -> f64 {
        let bits = bytes.iter().rev().fold(0_u64, |bits, &byte| bits << 8 | u64::from(byte));
        match self {
            Self::Unsigned(_) => bits as f64,
            Self::Signed(bytes) => {
                let unused = 64 - 8 * bytes as u32;
                ((bits << unused).cast_signed() >> unused) as f64
            }
            Self::Float(4) => f64::from(f32::from_bits(bits as u32)),
            Self::Float(_) => f64::from_bits(bits),
        }
    }
}

struct Header {
    encoding: Encoding,
    vertices: u64,
    properties: Vec<(String, Kind)>,
}

/// More properties than any vertex has; Gaussians with all spherical harmonics have 62.
const MAX_PROPERTIES: usize = 1024;

/// Reads the vertices. They must be the first element, and have x, y and z; red, green and blue are taken if there are
/// all three.
pub(crate) fn read_points(path: &Path) -> Result<Vec<ScenePoint>> {
    let mut lines = Lines::open(path)?;
    let header = header(path, &mut lines)?;
    let place = |name: &str| header.properties.iter().position(|(property, _)| property == name);
    let coordinate = |name| place(name).ok_or_else(|| broken(path, FormatRule::NoProperty { name }));
    let position = [coordinate("x")?, coordinate("y")?, coordinate("z")?];
    let colour = [place("red"), place("green"), place("blue")];
    let point = |values: &[f64]| {
        let xyz = position.map(|i| values[i]);
        if let Some(&found) = xyz.iter().find(|value| !value.is_finite()) {
            return Err(FormatRule::NotFinite { what: "position of a point", found });
        }
        let rgb = match colour {
            [Some(r), Some(g), Some(b)] => Some([values[r], values[g], values[b]]),
            _ => None,
        };
        if let Some(found) = rgb.and_then(|rgb| rgb.into_iter().find(|v| !(0.0..=255.0).contains(v))) {
            return Err(FormatRule::Colour { found });
        }
        Ok(ScenePoint {
            position: DVec3::from(xyz),
            colour: rgb.map(|rgb| rgb.map(|value| value as u8)),
            error: None,
            observations: Vec::new(),
        })
    };

    let mut points = Vec::new();
    let mut values = vec![0.0; header.properties.len()];
    if header.encoding == Encoding::Text {
        for _ in 0..header.vertices {
            let Some(line) = lines.next_line()? else {
                let (what, wanted) = ("a vertex", header.properties.len() as u64);
                return Err(broken(path, FormatRule::Cut { what, wanted, held: 0 }));
            };
            let words: Vec<&str> = line.words().collect();
            if words.len() != values.len() {
                let expected = "as many numbers as the vertex has properties";
                return Err(line.broken(FormatRule::Words { expected, found: words.len() }));
            }
            for (value, word) in values.iter_mut().zip(words) {
                *value = line.parsed("a property", word, "a number")?;
            }
            points.push(point(&values).map_err(|rule| line.broken(rule))?);
        }
        return Ok(points);
    }
    let stride: usize = header.properties.iter().map(|(_, kind)| kind.bytes()).sum();
    let mut body = lines.into_inner();
    let at = std::io::Seek::stream_position(&mut body).map_err(unreadable(path))?;
    let length = body.get_ref().metadata().map_err(unreadable(path))?.len();
    let most = length.saturating_sub(at) / (stride as u64).max(1);
    if header.vertices > most {
        return Err(broken(path, FormatRule::Count { what: "vertices", found: header.vertices, most }));
    }
    let mut bytes = vec![0; stride];
    for index in 0..header.vertices {
        body.read_exact(&mut bytes).map_err(unreadable(path))?;
        let mut rest = bytes.as_mut_slice();
        for (value, (_, kind)) in values.iter_mut().zip(&header.properties) {
            let (number, after) = rest.split_at_mut(kind.bytes());
            if header.encoding == Encoding::Big {
                number.reverse();
            }
            *value = kind.number(number);
            rest = after;
        }
        let place = Place::Byte(at + index * stride as u64);
        let broken = |rule| Error::Format { path: path.to_path_buf(), place, rule };
        points.push(point(&values).map_err(broken)?);
    }
    Ok(points)
}

fn header(path: &Path, lines: &mut Lines) -> Result<Header> {
    let mut header = Header { encoding: Encoding::Text, vertices: 0, properties: Vec::new() };
    // Elements so far: vertices must be the first, what follows them is not read.
    let mut elements = 0;
    let mut expected = "ply";
    while let Some(line) = lines.next_line()? {
        let wrong = |expected| {
            const SHOWN: usize = 60;
            line.broken(FormatRule::Header { found: line.text.chars().take(SHOWN).collect(), expected })
        };
        let words: Vec<&str> = line.words().collect();
        match (expected, words.as_slice()) {
            ("ply", ["ply"]) => expected = "format",
            ("ply", _) => return Err(wrong("ply")),
            (_, ["comment" | "obj_info", ..] | []) => {}
            ("format", ["format", word, "1.0"]) => {
                header.encoding = match *word {
                    "ascii" => Encoding::Text,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    _ => return Err(wrong("ascii, binary_little_endian or binary_big_endian")),
                };
                expected = "element";
            }
            ("format", _) => {
                return Err(wrong("format ascii, binary_little_endian or binary_big_endian 1.0"));
            }
            (_, ["element", name, count]) => {
                elements += 1;
                let count = line.parsed("count of the element", count, "a whole number")?;
                match (elements, *name) {
                    (1, "vertex") => header.vertices = count,
                    (1, _) => return Err(wrong("element vertex before all others")),
                    _ => {}
                }
            }
            (_, ["property", kind, name]) if elements == 1 => {
                let kind = Kind::of(kind).ok_or_else(|| wrong("a type of numbers"))?;
                if header.properties.len() == MAX_PROPERTIES {
                    return Err(wrong("at most 1024 properties"));
                }
                header.properties.push(((*name).to_owned(), kind));
            }
            (_, ["property", ..]) if elements > 1 => {}
            (_, ["end_header"]) => return Ok(header),
            _ => return Err(wrong("element, property of one number, or end_header")),
        }
    }
    Err(broken(path, FormatRule::Cut { what: "the header", wanted: 1, held: 0 }))
}
