use crate::error::PlyRule;
use crate::{
    Error, Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, QUATERNION, Result, sh_coefficients, write_atomically,
};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;

/// Longest header that is read; a real one has some 2 KiB.
const HEADER_LIMIT: u64 = 64 * 1024;

/// Property names of a file of the given SH degree, in the order of the original 3DGS writer.
fn property_names(degree: usize) -> Vec<String> {
    let rest = 3 * (sh_coefficients(degree) - 1);
    ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
        .map(str::to_owned)
        .into_iter()
        .chain((0..rest).map(|i| format!("f_rest_{i}")))
        .chain(["opacity"].map(str::to_owned))
        .chain((0..3).map(|i| format!("scale_{i}")))
        .chain((0..4).map(|i| format!("rot_{i}")))
        .collect()
}

/// Where a named property goes: a column of the geometry row, or a place in the SH row.
#[derive(Clone, Copy)]
enum Slot {
    Geometry(usize),
    Sh(usize),
}

/// The slot of a property name, `None` for what a Gaussian does not need (normals, unknown columns).
/// `f_rest` is channel-major in the file (all red coefficients first), SH rows are coefficient-major.
fn slot(name: &str, degree: usize) -> Option<Slot> {
    let indexed = |prefix: &str, limit: usize| {
        let index: usize = name.strip_prefix(prefix)?.parse().ok()?;
        (index < limit).then_some(index)
    };
    let rest_per_channel = sh_coefficients(degree) - 1;
    match name {
        "x" => return Some(Slot::Geometry(MEAN.start)),
        "y" => return Some(Slot::Geometry(MEAN.start + 1)),
        "z" => return Some(Slot::Geometry(MEAN.start + 2)),
        "opacity" => return Some(Slot::Geometry(OPACITY_LOGIT)),
        _ => {}
    }
    if let Some(i) = indexed("rot_", 4) {
        Some(Slot::Geometry(QUATERNION.start + i))
    } else if let Some(i) = indexed("scale_", 3) {
        Some(Slot::Geometry(LOG_SCALE.start + i))
    } else if let Some(i) = indexed("f_dc_", 3) {
        Some(Slot::Sh(i))
    } else {
        let i = indexed("f_rest_", 3 * rest_per_channel)?;
        Some(Slot::Sh((1 + i % rest_per_channel) * 3 + i / rest_per_channel))
    }
}

/// Writes a scene in the original 3DGS layout: binary little endian, world frame, all SH coefficients, log-scales,
/// logit opacity, quaternion (w, x, y, z) as stored, normals 0. Every stored bit is kept.
///
/// # Errors
/// If the file cannot be written.
pub fn write_ply(path: &Path, gaussians: &Gaussians) -> Result<()> {
    write_atomically(path, |out| encode_ply(out, gaussians))
}

/// The bytes that [`write_ply`] puts into a file.
///
/// # Errors
/// If `out` takes no more.
pub fn encode_ply(out: &mut dyn Write, gaussians: &Gaussians) -> std::io::Result<()> {
    let names = property_names(gaussians.sh_degree());
    let slots: Vec<_> = names.iter().map(|name| slot(name, gaussians.sh_degree())).collect();
    let sh_row = sh_coefficients(gaussians.sh_degree()) * 3;
    writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment SplatRenderMode: default")?;
    writeln!(out, "element vertex {}", gaussians.len())?;
    for name in &names {
        writeln!(out, "property float {name}")?;
    }
    writeln!(out, "end_header")?;
    let rows =
        gaussians.geometry().chunks_exact(Gaussians::GEOMETRY).zip(gaussians.sh().chunks_exact(sh_row));
    let mut bytes = Vec::with_capacity(slots.len() * 4);
    for (geometry, sh) in rows {
        bytes.clear();
        for slot in &slots {
            let value = match *slot {
                Some(Slot::Geometry(i)) => geometry[i],
                Some(Slot::Sh(i)) => sh[i],
                None => 0.0,
            };
            bytes.extend_from_slice(&value.to_le_bytes());
        }
        out.write_all(&bytes)?;
    }
    Ok(())
}

/// Scalar types of the format.
#[derive(Clone, Copy, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
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

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    fn decode(self, bytes: &[u8]) -> f32 {
        fn array<const N: usize>(bytes: &[u8]) -> [u8; N] {
            let mut out = [0; N];
            out.copy_from_slice(&bytes[..N]);
            out
        }
        match self {
            Self::I8 => f32::from(bytes[0].cast_signed()),
            Self::U8 => f32::from(bytes[0]),
            Self::I16 => f32::from(i16::from_le_bytes(array(bytes))),
            Self::U16 => f32::from(u16::from_le_bytes(array(bytes))),
            Self::I32 => i32::from_le_bytes(array(bytes)) as f32,
            Self::U32 => u32::from_le_bytes(array(bytes)) as f32,
            Self::F32 => f32::from_le_bytes(array(bytes)),
            Self::F64 => f64::from_le_bytes(array(bytes)) as f32,
        }
    }
}

struct Header {
    binary: bool,
    vertices: u64,
    properties: Vec<(Scalar, String)>,
}

fn read_header(reader: &mut impl BufRead) -> std::io::Result<std::result::Result<Header, PlyRule>> {
    let mut limited = reader.take(HEADER_LIMIT);
    let mut next_line = || -> std::io::Result<Option<String>> {
        let mut bytes = Vec::new();
        limited.read_until(b'\n', &mut bytes)?;
        if bytes.pop() != Some(b'\n') {
            return Ok(None);
        }
        Ok(Some(String::from_utf8_lossy(&bytes).trim_end_matches('\r').to_owned()))
    };
    if next_line()?.as_deref() != Some("ply") {
        return Ok(Err(PlyRule::Magic));
    }
    let mut header = Header { binary: true, vertices: 0, properties: Vec::new() };
    let (mut elements, mut formatted) = (0, false);
    loop {
        let Some(line) = next_line()? else {
            return Ok(Err(PlyRule::HeaderEnd));
        };
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["end_header"] => break,
            ["comment" | "obj_info", ..] | [] => {}
            ["format", format, "1.0"] if ["ascii", "binary_little_endian"].contains(format) => {
                header.binary = *format != "ascii";
                formatted = true;
            }
            ["format", found @ ..] => {
                return Ok(Err(PlyRule::Format { found: found.join(" ") }));
            }
            ["element", name, count] => {
                elements += 1;
                if elements == 1 {
                    let Ok(count) = count.parse() else {
                        return Ok(Err(PlyRule::HeaderLine { line }));
                    };
                    if *name != "vertex" {
                        return Ok(Err(PlyRule::NoVertex));
                    }
                    header.vertices = count;
                }
            }
            // Elements behind the vertices (faces, say) are not read.
            ["property", ..] if elements > 1 => {}
            ["property", "list", _, _, name] => {
                return Ok(Err(PlyRule::ListProperty { name: (*name).into() }));
            }
            ["property", kind, name] if elements == 1 => match Scalar::named(kind) {
                Some(scalar) => header.properties.push((scalar, (*name).to_owned())),
                None => return Ok(Err(PlyRule::HeaderLine { line })),
            },
            _ => return Ok(Err(PlyRule::HeaderLine { line })),
        }
    }
    Ok(match (elements, formatted) {
        (0, _) => Err(PlyRule::NoVertex),
        (_, false) => Err(PlyRule::Format { found: String::new() }),
        _ => Ok(header),
    })
}

/// Reads a scene in the original 3DGS layout, binary little endian or ASCII. Columns are found by name; unknown ones
/// are ignored; the SH degree follows from the number of `f_rest_*` columns.
///
/// # Errors
/// If the file cannot be read, breaks a rule of the format (see [`PlyRule`]), or ends early. Memory grows with
/// the data that is there, not with what the header promises.
pub fn read_ply(path: &Path) -> Result<Gaussians> {
    let io = |source| Error::Io { action: "read", path: path.to_path_buf(), source };
    let broken = |rule| Error::Ply { path: path.to_path_buf(), rule };
    let mut reader = BufReader::with_capacity(1 << 20, File::open(path).map_err(io)?);
    let header = read_header(&mut reader).map_err(io)?.map_err(broken)?;

    let rest = header.properties.iter().filter(|(_, name)| name.starts_with("f_rest_")).count();
    let Some(degree) = (0..=3).find(|&d| 3 * (sh_coefficients(d) - 1) == rest) else {
        return Err(broken(PlyRule::RestCount { found: rest }));
    };
    for needed in property_names(degree) {
        let present = header.properties.iter().any(|(_, name)| *name == needed);
        if !present && slot(&needed, degree).is_some() {
            return Err(broken(PlyRule::MissingProperty { name: needed }));
        }
    }
    let slots: Vec<_> =
        header.properties.iter().map(|(scalar, name)| (*scalar, slot(name, degree))).collect();

    let (mut geometry, mut sh) = (Vec::new(), Vec::new());
    let mut geometry_row = [0.0; Gaussians::GEOMETRY];
    let mut sh_row = vec![0.0; sh_coefficients(degree) * 3];
    let row_bytes = slots.iter().map(|(scalar, _)| scalar.size()).sum();
    let (mut bytes, mut line) = (vec![0; row_bytes], Vec::new());
    let mut values = Vec::with_capacity(slots.len());
    for vertex in 0..header.vertices {
        let truncated = || broken(PlyRule::Truncated { promised: header.vertices, found: vertex });
        values.clear();
        if header.binary {
            reader.read_exact(&mut bytes).map_err(|error| match error.kind() {
                std::io::ErrorKind::UnexpectedEof => truncated(),
                _ => io(error),
            })?;
            let mut rest = bytes.as_slice();
            for &(scalar, _) in &slots {
                values.push(scalar.decode(rest));
                rest = &rest[scalar.size()..];
            }
        } else {
            line.clear();
            // A row of 62 numbers stays far below the header's limit, so one limit serves both.
            (&mut reader).take(HEADER_LIMIT).read_until(b'\n', &mut line).map_err(io)?;
            let text = String::from_utf8_lossy(&line);
            let mut words = text.split_ascii_whitespace();
            for _ in &slots {
                let word = words.next().ok_or_else(truncated)?;
                let number = word.parse().map_err(|_| broken(PlyRule::Number { vertex, found: word.into() }));
                values.push(number?);
            }
        }
        for (&(_, slot), &value) in slots.iter().zip(&values) {
            match slot {
                Some(Slot::Geometry(i)) => geometry_row[i] = value,
                Some(Slot::Sh(i)) => sh_row[i] = value,
                None => {}
            }
        }
        geometry.extend_from_slice(&geometry_row);
        sh.extend_from_slice(&sh_row);
    }
    Gaussians::new(degree, geometry, sh)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::fs;

    fn scene(degree: usize, n: usize, seed: u32) -> Gaussians {
        // Every bit pattern may be stored, NaN included.
        let mut state = seed;
        let mut bits = |count: usize| {
            (0..count)
                .map(|_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    f32::from_bits(state)
                })
                .collect::<Vec<_>>()
        };
        Gaussians::new(degree, bits(n * 11), bits(n * sh_coefficients(degree) * 3)).unwrap()
    }

    fn same_bits(a: &Gaussians, b: &Gaussians) -> bool {
        let bits = |g: &Gaussians| g.geometry().iter().chain(g.sh()).map(|v| v.to_bits()).collect::<Vec<_>>();
        a.sh_degree() == b.sh_degree() && bits(a) == bits(b)
    }

    fn read_text(text: &[u8]) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.ply");
        fs::write(&path, text).unwrap();
        let error = read_ply(&path).unwrap_err().to_string();
        error.split_once("x.ply: ").expect("the error names the file").1.to_owned()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn writing_and_reading_changes_no_bit(degree in 0usize..4, n in 0usize..20, seed: u32) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("x.ply");
            let scene = scene(degree, n, seed);
            write_ply(&path, &scene).unwrap();
            prop_assert!(same_bits(&read_ply(&path).unwrap(), &scene));
        }

        #[test]
        fn a_cut_or_corrupt_file_is_an_error_or_a_scene_but_never_a_panic(
            cut in 0usize..2000, byte in 0usize..2000, value: u8,
        ) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("x.ply");
            write_ply(&path, &scene(1, 3, 7)).unwrap();
            let mut bytes = fs::read(&path).unwrap();
            let whole = bytes.len();
            let byte = byte % whole;
            bytes[byte] = value;
            bytes.truncate(cut.min(whole));
            fs::write(&path, &bytes).unwrap();
            let read = read_ply(&path);
            if cut < whole && byte > 600 {
                prop_assert!(read.is_err());
            }
        }
    }

    #[test]
    fn rest_coefficients_are_channel_major_in_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.ply");
        let sh: Vec<f32> = (0..12).map(|i| i as f32).collect();
        write_ply(&path, &Gaussians::new(1, vec![0.0; 11], sh).unwrap()).unwrap();
        let bytes = fs::read(&path).unwrap();
        let data = &bytes[bytes.len() - (6 + 12 + 8) * 4..];
        let values: Vec<f32> =
            data.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
        assert_eq!(values[6..18], [0.0, 1.0, 2.0, 3.0, 6.0, 9.0, 4.0, 7.0, 10.0, 5.0, 8.0, 11.0]);
    }

    #[test]
    fn ascii_with_extra_columns_and_elements_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.ply");
        let columns =
            "x y z label f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
        let header: String = columns.split(' ').map(|c| format!("property double {c}\n")).collect();
        let text = format!(
            "ply\r\nformat ascii 1.0\ncomment hello\nelement vertex 1\n{header}element face 1\n\
             property list uchar int i\nend_header\n1 2 3 77 .1 .2 .3 -1 -2 -3 -4 1 0 0 0\n3 0 0 0\n"
        );
        fs::write(&path, text).unwrap();
        let scene = read_ply(&path).unwrap();
        assert_eq!(scene.geometry(), [1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0, -2.0, -3.0, -4.0, -1.0]);
        assert_eq!(scene.sh(), [0.1, 0.2, 0.3]);
    }

    #[test]
    fn broken_files_name_their_rule() {
        let base = "ply\nformat binary_little_endian 1.0\nelement vertex 18446744073709551615\n";
        let all: String =
            property_names(0).iter().map(|name| format!("property float {name}\n")).collect::<String>();
        assert_eq!(read_text(b"solid"), "not a PLY file (the first line is not \"ply\")");
        assert!(read_text(base.as_bytes()).starts_with("the header has no end_header"));
        assert!(
            read_text(&[b"ply\n".as_slice(), &vec![b'x'; 1 << 17]].concat()).starts_with("the header has no")
        );
        assert_eq!(
            read_text(b"ply\nformat binary_big_endian 1.0\nend_header\n"),
            "format \"binary_big_endian 1.0\" is not supported, expected binary_little_endian 1.0 or ascii 1.0"
        );
        assert_eq!(read_text(b"ply\nformat ascii 1.0\nend_header\n"), "the first element must be \"vertex\"");
        assert!(
            read_text(b"ply\nformat ascii 1.0\nelement vertex -1\nend_header\n")
                .contains("is not understood")
        );
        assert!(
            read_text(format!("{base}property float x\nend_header\n").as_bytes())
                .starts_with("vertex property \"y\"")
        );
        assert!(
            read_text(format!("{base}property list uchar int x\nend_header\n").as_bytes())
                .contains("is a list")
        );
        assert!(
            read_text(format!("{base}{all}property float f_rest_0\nend_header\n").as_bytes())
                .starts_with("1 f_rest properties")
        );
        // An absurd count must fail by running out of data, without reserving memory for it.
        assert_eq!(
            read_text(format!("{base}{all}end_header\n").as_bytes()),
            "truncated: the header promises 18446744073709551615 vertices, the data ends in vertex 0"
        );
        let ascii = format!("ply\nformat ascii 1.0\nelement vertex 1\n{all}end_header\n1 two 3\n");
        assert_eq!(read_text(ascii.as_bytes()), "vertex 0: \"two\" is not a number");
    }
}
