//! The header of a PLY file: which numbers follow, and how they are written.

use crate::MeshRule;
use std::io::{BufRead, Read};

/// Longest header that is read; a real one has some 1 KiB.
const HEADER_LIMIT: u64 = 64 * 1024;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// Scalar types of the format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Scalar(Scalar),
    /// A count, and so many items.
    List(Scalar, Scalar),
}

#[derive(Debug)]
pub(super) struct Property {
    pub(super) name: String,
    pub(super) kind: Kind,
}

#[derive(Debug)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

#[derive(Debug)]
pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// Its length with the line end behind it, bytes.
    pub(super) bytes: u64,
}

impl Scalar {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    pub(super) fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// The number of which a colour channel is a share: the largest of an integer type, 1 for the others.
    pub(super) fn full(self) -> f64 {
        match self {
            Self::I8 => 127.0,
            Self::U8 => 255.0,
            Self::I16 => 32767.0,
            Self::U16 => 65535.0,
            Self::I32 => 2_147_483_647.0,
            Self::U32 => 4_294_967_295.0,
            Self::F32 | Self::F64 => 1.0,
        }
    }

    /// The number in the first bytes, little endian.
    pub(super) fn decode(self, bytes: [u8; 8]) -> f64 {
        let [a, b, c, d, ..] = bytes;
        match self {
            Self::I8 => a.cast_signed().into(),
            Self::U8 => a.into(),
            Self::I16 => i16::from_le_bytes([a, b]).into(),
            Self::U16 => u16::from_le_bytes([a, b]).into(),
            Self::I32 => i32::from_le_bytes([a, b, c, d]).into(),
            Self::U32 => u32::from_le_bytes([a, b, c, d]).into(),
            Self::F32 => f32::from_le_bytes([a, b, c, d]).into(),
            Self::F64 => f64::from_le_bytes(bytes),
        }
    }
}

impl Element {
    /// The fewest bytes that the element can take: lists may be empty, and a word needs a space.
    pub(super) fn least_bytes(&self, encoding: Encoding) -> u128 {
        let least = |property: &Property| match (encoding, property.kind) {
            (Encoding::Ascii, _) => 2,
            (_, Kind::Scalar(scalar) | Kind::List(scalar, _)) => scalar.size() as u128,
        };
        u128::from(self.count) * self.properties.iter().map(least).sum::<u128>()
    }
}

/// Reads the header of a file.
pub(super) fn read_header(reader: &mut impl BufRead) -> std::io::Result<Result<Header, MeshRule>> {
    let mut limited = reader.take(HEADER_LIMIT);
    let mut next_line = || -> std::io::Result<Option<String>> {
        let mut bytes = Vec::new();
        limited.read_until(b'\n', &mut bytes)?;
        let whole = bytes.pop() == Some(b'\n');
        Ok(whole.then(|| String::from_utf8_lossy(&bytes).trim_end().to_owned()))
    };
    let (mut encoding, mut elements) = (None, Vec::<Element>::new());
    if next_line()?.as_deref() != Some("ply") {
        return Ok(Err(MeshRule::PlyMagic));
    }
    for number in 2.. {
        let Some(line) = next_line()? else { return Ok(Err(MeshRule::PlyHeaderEnd)) };
        match parse_line(&line, &mut encoding, &mut elements) {
            Some(Line::More) => {}
            Some(Line::End) => break,
            None => return Ok(Err(MeshRule::PlyHeaderLine { line: number, found: line })),
        }
    }
    let bytes = HEADER_LIMIT - limited.limit();
    Ok(encoding.map(|encoding| Header { encoding, elements, bytes }).ok_or(MeshRule::PlyFormat))
}

enum Line {
    More,
    End,
}

/// `None` if the line breaks the rules.
fn parse_line(line: &str, encoding: &mut Option<Encoding>, elements: &mut Vec<Element>) -> Option<Line> {
    let words: Vec<&str> = line.split_ascii_whitespace().collect();
    match words.as_slice() {
        ["end_header"] => return Some(Line::End),
        [] | ["comment" | "obj_info", ..] => {}
        ["format", name, "1.0"] if encoding.is_none() => {
            *encoding = Some(match *name {
                "ascii" => Encoding::Ascii,
                "binary_little_endian" => Encoding::LittleEndian,
                "binary_big_endian" => Encoding::BigEndian,
                _ => return None,
            });
        }
        ["element", name, count] if elements.iter().all(|element| element.name != *name) => {
            let count = count.parse().ok()?;
            elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
        }
        ["property", kind @ .., name] => {
            let kind = match kind {
                [scalar] => Kind::Scalar(Scalar::named(scalar)?),
                ["list", count, item] => {
                    let count = Scalar::named(count).filter(|scalar| scalar.is_integer())?;
                    Kind::List(count, Scalar::named(item)?)
                }
                _ => return None,
            };
            let properties = &mut elements.last_mut()?.properties;
            if properties.iter().any(|property| property.name == *name) {
                return None;
            }
            properties.push(Property { name: (*name).to_owned(), kind });
        }
        _ => return None,
    }
    Some(Line::More)
}
