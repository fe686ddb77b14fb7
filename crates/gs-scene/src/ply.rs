use crate::{
    Error, Gaussians, LOG_SCALE, MEAN, OPACITY_LOGIT, PlyEncoding, PlyHeader, PlyRule, PlyScalar, QUATERNION,
    Result, sh_coefficients, write_atomically,
};
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;

/// Longest line of an ASCII file; a row of 62 numbers has some 1 KiB.
const LINE_LIMIT: u64 = 64 * 1024;

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

/// Reads a scene in the original 3DGS layout, binary little endian or ASCII. Columns are found by name; unknown ones
/// are ignored; the SH degree follows from the number of `f_rest_*` columns.
///
/// # Errors
/// If the file cannot be read, breaks a rule of the format (see [`PlyRule`]), or ends early. Memory grows with
/// the data that is there, not with what the header promises.
pub fn read_ply(path: &Path) -> Result<Gaussians> {
    let io = |source| Error::Io { action: "read", path: path.to_path_buf(), source };
    let mut reader = BufReader::with_capacity(1 << 20, File::open(path).map_err(io)?);
    let header = PlyHeader::read(&mut reader).map_err(io)?;
    let header = header.map_err(|rule| Error::Ply { path: path.to_path_buf(), rule })?;
    read_ply_vertices(path, &header, &mut reader)
}

/// A number of the file as f32. An f32 keeps its bits, which a way through f64 may change (signalling NaN).
fn number(scalar: PlyScalar, bytes: &[u8]) -> f32 {
    let mut padded = [0; 8];
    padded[..scalar.size()].copy_from_slice(&bytes[..scalar.size()]);
    let [a, b, c, d, ..] = padded;
    if scalar == PlyScalar::F32 { f32::from_le_bytes([a, b, c, d]) } else { scalar.decode(padded) as f32 }
}

/// Reads the Gaussians behind a header that was read already; `path` is named by errors.
///
/// # Errors
/// Those of [`read_ply`].
pub fn read_ply_vertices(path: &Path, header: &PlyHeader, reader: &mut impl BufRead) -> Result<Gaussians> {
    let io = |source| Error::Io { action: "read", path: path.to_path_buf(), source };
    let broken = |rule| Error::Ply { path: path.to_path_buf(), rule };
    if header.encoding == PlyEncoding::BigEndian {
        return Err(broken(PlyRule::Format { found: "binary_big_endian 1.0".into() }));
    }
    // Elements behind the vertices (faces, say) are not read.
    let vertices = header.elements.first().filter(|element| element.name == "vertex");
    let vertices = vertices.ok_or_else(|| broken(PlyRule::NoVertex))?;
    let scalars = vertices.scalars().map_err(broken)?;
    let names = || vertices.properties.iter().map(|property| property.name.as_str());

    let rest = names().filter(|name| name.starts_with("f_rest_")).count();
    let Some(degree) = (0..=3).find(|&d| 3 * (sh_coefficients(d) - 1) == rest) else {
        return Err(broken(PlyRule::RestCount { found: rest }));
    };
    for needed in property_names(degree) {
        if vertices.column(&needed).is_none() && slot(&needed, degree).is_some() {
            return Err(broken(PlyRule::MissingProperty { name: needed }));
        }
    }
    let slots: Vec<_> = scalars.into_iter().zip(names().map(|name| slot(name, degree))).collect();

    let (mut geometry, mut sh) = (Vec::new(), Vec::new());
    let mut geometry_row = [0.0; Gaussians::GEOMETRY];
    let mut sh_row = vec![0.0; sh_coefficients(degree) * 3];
    let row_bytes = slots.iter().map(|(scalar, _)| scalar.size()).sum();
    let (mut bytes, mut line) = (vec![0; row_bytes], Vec::new());
    let mut values = Vec::with_capacity(slots.len());
    for vertex in 0..vertices.count {
        let truncated = || broken(PlyRule::Truncated { promised: vertices.count, found: vertex });
        values.clear();
        if header.encoding == PlyEncoding::LittleEndian {
            reader.read_exact(&mut bytes).map_err(|error| match error.kind() {
                std::io::ErrorKind::UnexpectedEof => truncated(),
                _ => io(error),
            })?;
            let mut rest = bytes.as_slice();
            for &(scalar, _) in &slots {
                values.push(number(scalar, rest));
                rest = &rest[scalar.size()..];
            }
        } else {
            line.clear();
            reader.by_ref().take(LINE_LIMIT).read_until(b'\n', &mut line).map_err(io)?;
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
