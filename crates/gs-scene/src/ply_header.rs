use crate::PlyRule;
use std::io::{BufRead, Read};

/// Longest header that is read; a real one has some 2 KiB.
const HEADER_LIMIT: u64 = 64 * 1024;

/// The header of a PLY file (Stanford polygon format): which numbers follow, and how they are written.
///
/// The one parser of the project. Nothing is reserved for the counts that a header states.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlyHeader {
    /// How the numbers behind the header are written.
    pub encoding: PlyEncoding,
    /// What follows the header, in this order. No two have one name.
    pub elements: Vec<PlyElement>,
    /// The words of the comments, each with one space between two words.
    pub comments: Vec<String>,
    /// Lines of the header, `end_header` included.
    pub lines: u64,
    /// Length of the header with the line end behind it, bytes.
    pub bytes: u64,
}

/// How the numbers of a PLY file are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlyEncoding {
    /// As words, a line for each entry of an element.
    Ascii,
    /// Lowest byte first.
    LittleEndian,
    /// Highest byte first.
    BigEndian,
}

/// A table of a PLY file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlyElement {
    /// Its name, such as `vertex`.
    pub name: String,
    /// Number of rows, as the header states it.
    pub count: u64,
    /// Columns. No two have one name.
    pub properties: Vec<PlyProperty>,
}

/// A column of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PlyProperty {
    /// Its name, such as `x`.
    pub name: String,
    /// What a row has there.
    pub kind: PlyKind,
}

/// What a row has in a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlyKind {
    /// One number.
    Scalar(PlyScalar),
    /// A count of an integer type, and so many items.
    List(PlyScalar, PlyScalar),
}

/// Types of numbers in PLY files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names say all")]
pub enum PlyScalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl PlyScalar {
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

    /// Length in binary files, bytes.
    #[must_use]
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Whether the type holds whole numbers only.
    #[must_use]
    pub fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    /// The number in the first bytes, lowest byte first. Every type fits into f64.
    #[must_use]
    pub fn decode(self, bytes: [u8; 8]) -> f64 {
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

impl PlyElement {
    /// The position of a column.
    #[must_use]
    pub fn column(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|property| property.name == name)
    }

    /// Types of the columns.
    ///
    /// # Errors
    /// If one is a list.
    pub fn scalars(&self) -> Result<Vec<PlyScalar>, PlyRule> {
        let scalar = |property: &PlyProperty| match property.kind {
            PlyKind::Scalar(scalar) => Ok(scalar),
            PlyKind::List(..) => {
                Err(PlyRule::ListProperty { element: self.name.clone(), name: property.name.clone() })
            }
        };
        self.properties.iter().map(scalar).collect()
    }
}

impl PlyHeader {
    /// Reads a header and leaves the reader at the first byte behind it.
    ///
    /// # Errors
    /// The outer error is the system's. The inner one names the rule that the header breaks.
    pub fn read(reader: &mut impl BufRead) -> std::io::Result<Result<Self, PlyRule>> {
        let mut limited = reader.take(HEADER_LIMIT);
        let mut next_line = || -> std::io::Result<Option<String>> {
            let mut bytes = Vec::new();
            limited.read_until(b'\n', &mut bytes)?;
            let whole = bytes.pop() == Some(b'\n');
            Ok(whole.then(|| String::from_utf8_lossy(&bytes).trim_end().to_owned()))
        };
        if next_line()?.as_deref() != Some("ply") {
            return Ok(Err(PlyRule::Magic));
        }
        let (mut encoding, mut elements, mut comments, mut lines) = (None, Vec::new(), Vec::new(), 1);
        loop {
            let Some(line) = next_line()? else { return Ok(Err(PlyRule::HeaderEnd)) };
            lines += 1;
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words.as_slice() {
                ["end_header"] => break,
                ["comment", words @ ..] => comments.push(words.join(" ")),
                ["format", found @ ..] if encoding.is_none() => match PlyEncoding::named(found) {
                    Some(named) => encoding = Some(named),
                    None => return Ok(Err(PlyRule::Format { found: found.join(" ") })),
                },
                words if declare(words, &mut elements).is_none() => {
                    return Ok(Err(PlyRule::HeaderLine { line: lines, found: line }));
                }
                _ => {}
            }
        }
        let bytes = HEADER_LIMIT - limited.limit();
        let header = |encoding| Self { encoding, elements, comments, lines, bytes };
        Ok(encoding.map(header).ok_or(PlyRule::NoFormat))
    }

    /// The element of this name.
    #[must_use]
    pub fn element(&self, name: &str) -> Option<&PlyElement> {
        self.elements.iter().find(|element| element.name == name)
    }
}

impl PlyEncoding {
    fn named(words: &[&str]) -> Option<Self> {
        Some(match words {
            ["ascii", "1.0"] => Self::Ascii,
            ["binary_little_endian", "1.0"] => Self::LittleEndian,
            ["binary_big_endian", "1.0"] => Self::BigEndian,
            _ => return None,
        })
    }
}

/// Takes in a line of the header; `None` if it breaks the rules.
fn declare(words: &[&str], elements: &mut Vec<PlyElement>) -> Option<()> {
    match words {
        [] | ["obj_info", ..] => {}
        ["element", name, count] if elements.iter().all(|element| element.name != *name) => {
            let count = count.parse().ok()?;
            elements.push(PlyElement { name: (*name).to_owned(), count, properties: Vec::new() });
        }
        ["property", kind @ .., name] => {
            let kind = match kind {
                [scalar] => PlyKind::Scalar(PlyScalar::named(scalar)?),
                ["list", count, item] => {
                    let count = PlyScalar::named(count).filter(|scalar| scalar.is_integer())?;
                    PlyKind::List(count, PlyScalar::named(item)?)
                }
                _ => return None,
            };
            let element = elements.last_mut()?;
            if element.column(name).is_some() {
                return None;
            }
            element.properties.push(PlyProperty { name: (*name).to_owned(), kind });
        }
        _ => return None,
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<PlyHeader, PlyRule> {
        PlyHeader::read(&mut text.as_bytes()).unwrap()
    }

    #[test]
    fn a_header_says_what_follows() {
        let text = "ply\r\nformat binary_big_endian 1.0\ncomment  made   by hand\nobj_info 3\n\nelement chunk 2\n\
                    property float min_x\nelement face 18446744073709551615\nproperty list uchar int32 corners\n\
                    end_header\nbody";
        let mut reader = text.as_bytes();
        let header = PlyHeader::read(&mut reader).unwrap().unwrap();
        assert_eq!(reader, b"body");
        assert_eq!((header.lines, header.bytes), (10, text.len() as u64 - 4));
        assert_eq!((header.encoding, header.comments), (PlyEncoding::BigEndian, vec!["made by hand".into()]));
        let face = &header.elements[1];
        assert_eq!((face.name.as_str(), face.count), ("face", u64::MAX));
        assert_eq!(face.properties[0].kind, PlyKind::List(PlyScalar::U8, PlyScalar::I32));
        assert!(matches!(face.scalars(), Err(PlyRule::ListProperty { .. })));
        assert_eq!(header.elements[0].scalars(), Ok(vec![PlyScalar::F32]));
    }

    #[test]
    fn broken_headers_name_the_line() {
        let head = "ply\nformat ascii 1.0\nelement vertex 3\n";
        let line = |text: &str| match read(text) {
            Err(PlyRule::HeaderLine { line, .. }) => line,
            other => panic!("{other:?}"),
        };
        for (more, number) in [
            ("property float x\nproperty float x\n", 5),
            ("element vertex 3\n", 4),
            ("element face -1\n", 4),
            ("property flout y\n", 4),
            ("property list float int y\n", 4),
            ("format ascii 1.0\n", 4),
            ("solid\n", 4),
        ] {
            assert_eq!(line(&format!("{head}{more}end_header\n")), number, "{more}");
        }
        assert_eq!(line("ply\nformat ascii 1.0\nproperty float x\nend_header\n"), 3);
        assert_eq!(read("ply\nend_header\n"), Err(PlyRule::NoFormat));
        assert_eq!(read(head), Err(PlyRule::HeaderEnd));
        assert_eq!(read("plyx\n"), Err(PlyRule::Magic));
        assert!(matches!(read("ply\nformat text 1.0\n"), Err(PlyRule::Format { .. })));
    }
}
