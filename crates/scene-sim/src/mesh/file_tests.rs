//! Tests of the readers with valid and broken files.

use super::obj::read_obj;
use super::ply::read_ply;
use super::polygons::Triangles;
use super::read::{FileError, Unused};
use crate::MeshRule;
use crate::texture::linear;
use glam::{DVec3, Vec3};
use proptest::prelude::*;
use std::fmt::Write;

/// Vertices, their colours of 0 to 255, polygons.
#[derive(Debug, Clone)]
struct Model {
    vertices: Vec<[f32; 3]>,
    colours: Vec<[u8; 3]>,
    faces: Vec<Vec<u32>>,
}

fn model() -> impl Strategy<Value = Model> {
    let vertex = (prop::array::uniform3(-100.0..100.0f32), any::<[u8; 3]>());
    prop::collection::vec(vertex, 3..30).prop_flat_map(|both| {
        let face = prop::collection::vec(0..both.len() as u32, 3..7);
        let (vertices, colours): (Vec<_>, Vec<_>) = both.into_iter().unzip();
        prop::collection::vec(face, 0..20).prop_map(move |faces| Model {
            vertices: vertices.clone(),
            colours: colours.clone(),
            faces,
        })
    })
}

impl Model {
    /// What a reader should make of it.
    fn expected(&self) -> Triangles {
        let mut mesh = Triangles {
            vertices: self.vertices.iter().map(|v| DVec3::from(v.map(f64::from))).collect(),
            colours: self.colours.iter().map(|c| linear(c.map(|v| f32::from(v) / 255.0))).collect(),
            ..Triangles::default()
        };
        self.faces.iter().for_each(|face| mesh.push_polygon(face).unwrap());
        mesh
    }

    /// A PLY file with properties and elements that a mesh has no use for strewn in.
    fn ply(&self, format: &str, index: &str) -> Vec<u8> {
        let mut out = format!(
            "ply\nformat {format} 1.0\ncomment made for a test\nelement camera 2\nproperty float f\n\
             property list uchar short row\nelement vertex {}\nproperty float nx\nproperty float x\nproperty float y\n\
             property float z\nproperty list int double bag\nproperty uchar red\nproperty uchar green\n\
             property uchar blue\nelement face {}\nproperty uchar flags\nproperty list uint {index} vertex_indices\n\
             element edge 1\nproperty int a\nend_header\n",
            self.vertices.len(),
            self.faces.len()
        )
        .into_bytes();
        let mut put = |kind: &str, value: f64| match (format, kind) {
            ("ascii", _) => out.extend(format!("{value} ").bytes()),
            ("binary_little_endian", "u8") => out.push(value as u8),
            ("binary_little_endian", "i16") => out.extend((value as i16).to_le_bytes()),
            ("binary_little_endian", "i32") => out.extend((value as i32).to_le_bytes()),
            ("binary_little_endian", "f32") => out.extend((value as f32).to_le_bytes()),
            ("binary_little_endian", _) => out.extend(value.to_le_bytes()),
            (_, "u8") => out.push(value as u8),
            (_, "i16") => out.extend((value as i16).to_be_bytes()),
            (_, "i32") => out.extend((value as i32).to_be_bytes()),
            (_, "f32") => out.extend((value as f32).to_be_bytes()),
            _ => out.extend(value.to_be_bytes()),
        };
        for camera in 0..2u8 {
            put("f32", 0.5);
            put("u8", camera.into());
            (0..camera).for_each(|k| put("i16", k.into()));
        }
        for (i, (vertex, colour)) in self.vertices.iter().zip(&self.colours).enumerate() {
            put("f32", 1.0);
            vertex.iter().for_each(|v| put("f32", (*v).into()));
            put("i32", (i % 3) as f64);
            (0..i % 3).for_each(|k| put("f64", k as f64));
            colour.iter().for_each(|c| put("u8", (*c).into()));
        }
        let index = if index == "uchar" { "u8" } else { "i32" };
        for face in &self.faces {
            put("u8", 7.0);
            put("i32", face.len() as f64);
            face.iter().for_each(|corner| put(index, (*corner).into()));
        }
        put("i32", -5.0);
        out
    }

    /// An OBJ file: absolute and relative indices in turn, comments, continuation lines, Windows line ends.
    fn obj(&self) -> String {
        let mut out = String::from("# a model\r\nmtllib some.mtl\r\no thing\r\n");
        for (v, c) in self.vertices.iter().zip(&self.colours) {
            let (v, [r, g, b]) = (v.map(f64::from), c.map(|v| f64::from(v) / 255.0));
            let _ = write!(out, "v {} {} \\\r\n {} {r} {g} {b} # vertex\r\n", v[0], v[1], v[2]);
        }
        out.push_str("usemtl red\r\nvn 0 0 1\r\ncurv 0 1\r\n");
        for (i, face) in self.faces.iter().enumerate() {
            let back = self.vertices.len() as i64;
            let corner = |v: &u32| match i % 3 {
                0 => format!(" {}", v + 1),
                1 => format!(" {}", i64::from(*v) - back),
                _ => format!(" {}//1", v + 1),
            };
            let _ = write!(out, "f{}\r\n", face.iter().map(corner).collect::<String>());
        }
        out
    }
}

fn ply(bytes: &[u8]) -> Result<(Triangles, Unused), FileError> {
    let mut unused = Unused::default();
    // A small buffer, so that words and numbers lie across its ends.
    let mut reader = std::io::BufReader::with_capacity(7, bytes);
    read_ply(&mut reader, bytes.len() as u64, &mut unused).map(|mesh| (mesh, unused))
}

fn obj(text: &str) -> Result<(Triangles, Unused), FileError> {
    let mut unused = Unused::default();
    read_obj(&mut text.as_bytes(), &mut unused).map(|mesh| (mesh, unused))
}

fn rule<T>(result: Result<T, FileError>) -> MeshRule {
    match result {
        Err(FileError::Rule(rule)) => rule,
        Err(FileError::Io(error)) => panic!("{error}"),
        Ok(_) => panic!("the file is refused"),
    }
}

fn close(a: &[Vec3], b: &[Vec3]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (*a - *b).abs().max_element() < 1e-6)
}

const FORMATS: [&str; 3] = ["ascii", "binary_little_endian", "binary_big_endian"];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn every_encoding_gives_the_model(model in model()) {
        let expected = model.expected();
        for format in FORMATS {
            for index in ["uchar", "int", "uint"] {
                let (mesh, unused) = ply(&model.ply(format, index)).unwrap();
                prop_assert_eq!(&mesh.vertices, &expected.vertices);
                prop_assert_eq!(&mesh.faces, &expected.faces);
                prop_assert!(close(&mesh.colours, &expected.colours));
                prop_assert_eq!((unused.elements, unused.bytes), (3, 0));
            }
        }
        let (mesh, unused) = obj(&model.obj()).unwrap();
        prop_assert_eq!(&mesh.vertices, &expected.vertices);
        prop_assert_eq!(&mesh.faces, &expected.faces);
        prop_assert!(close(&mesh.colours, &expected.colours));
        prop_assert_eq!((unused.materials, unused.lines), (2, 1));
    }

    #[test]
    fn a_file_that_ends_early_is_refused(model in model(), format in prop::sample::select(&FORMATS), share in 0.0..1.0f64) {
        let bytes = model.ply(format, "int");
        let length = ((bytes.len() - 2) as f64 * share) as usize;
        let result = ply(&bytes[..length]);
        // The file's last number is -5 and a space: without them an ASCII file ends in a minus or in nothing.
        prop_assert!(result.is_err());
    }

    #[test]
    fn broken_bytes_never_panic_or_hang(
        model in model(), format in prop::sample::select(&FORMATS), changes in prop::collection::vec((0.0..1.0f64, any::<u8>()), 1..6),
    ) {
        let mut bytes = model.ply(format, "int");
        let count = bytes.len() as f64;
        changes.iter().for_each(|(share, byte)| bytes[(share * count) as usize] = *byte);
        if let Ok((mesh, _)) = ply(&bytes) {
            prop_assert!(mesh.faces.iter().flatten().all(|index| (*index as usize) < mesh.vertices.len()));
        }
        let mut text = model.obj().into_bytes();
        let count = text.len() as f64;
        changes.iter().for_each(|(share, byte)| text[(share * count) as usize] = *byte);
        if let Ok(mesh) = read_obj(&mut text.as_slice(), &mut Unused::default()) {
            prop_assert!(mesh.faces.iter().flatten().all(|index| (*index as usize) < mesh.vertices.len()));
        }
    }
}

#[test]
fn headers_that_lie_are_refused_before_memory_is_taken() {
    for (format, bytes) in [("ascii", 6 << 60), ("binary_big_endian", u64::MAX)] {
        let text = format!(
            "ply\nformat {format} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n",
            1u64 << 60
        );
        let MeshRule::PlySize { promised, found } = rule(ply(text.as_bytes())) else {
            panic!("another rule")
        };
        assert!(promised >= bytes.min(6 << 60) && found == 6, "{promised} {found}");
    }
    // Elements that take no room are not counted one by one.
    let empty = format!(
        "ply\nformat ascii 1.0\nelement nothing {}\nelement vertex 1\nproperty float x\nproperty float y\n\
         property float z\nelement face 0\nproperty list uchar int vertex_index\nend_header\n1 2 3",
        u64::MAX
    );
    assert_eq!(ply(empty.as_bytes()).unwrap().0.vertices, [DVec3::new(1.0, 2.0, 3.0)]);
}

#[test]
fn each_broken_ply_names_its_rule() {
    let head =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n";
    let face = "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0 1 0 0 0 1 0\n";
    let refused = |text: String| rule(ply(text.as_bytes())).to_string();
    assert_eq!(refused("solid".into()), "not a PLY file (the first line is not \"ply\")");
    assert_eq!(refused(head.into()), "the header has no end_header line within its first 64 KiB");
    assert!(
        refused(head.replace("float y", "flout y"))
            .contains("header line 5 is not understood: \"property flout y\"")
    );
    assert!(refused(head.replace("float y", "float x")).contains("header line 5"));
    assert!(refused(format!("{head}element vertex 3\n")).contains("header line 7"));
    assert_eq!(refused("ply\nend_header\n".into()), "the header has no format line");
    assert_eq!(refused(format!("{head}end_header\n0 0 0 1 0 0 0 1 0")), "the header lacks an element face");
    assert_eq!(refused("ply\nformat ascii 1.0\nend_header\n".into()), "the header lacks an element vertex");
    assert!(
        refused(format!("{}{face}3 0 1 2", head.replace("float z", "float w")))
            .contains("vertex properties x, y, z")
    );
    let list = head.replace("float z", "list uchar float z");
    assert_eq!(refused(format!("{list}{face}3 0 1 2")), "vertex property \"z\" is a list, expected a number");
    let floats = face.replace("uchar int", "uchar float");
    assert!(refused(format!("{head}{floats}3 0 1 2")).contains("lacks a face property vertex_indices"));
    assert_eq!(refused(format!("{head}{face}3 0 1 9")), "face 0 names vertex 9, but there are 3");
    assert_eq!(refused(format!("{head}{face}3 0 1 -1")), "face 0 names vertex -1, but there are 3");
    assert_eq!(refused(format!("{head}{face}2 0 1")), "face 0 has 2 corners, expected 3 to 65536");
    assert_eq!(
        refused(format!("{head}{face}3 0 1.5 2")),
        "element \"face\" 0: \"1.5\" is not a number of the declared type"
    );
    assert_eq!(
        refused(format!("{head}{face}3 0 1")),
        "truncated: the header promises 1 of element \"face\", the data ends in number 0"
    );
    let (_, unused) = ply(format!("{head}{face}3 0 1 2\n left over \n").as_bytes()).unwrap();
    assert_eq!(unused.bytes, 8);
    let colours = "property float red\nproperty float green\nproperty float blue\n";
    let bright = format!(
        "{head}{colours}{}",
        face.replace("0 0 0 1 0 0 0 1 0", "0 0 0 1 1 1 1 0 0 0 0 2 0 1 0 0 0 0")
    );
    assert!(refused(format!("{bright}3 0 1 2")).starts_with("vertex 1: a colour channel is 2"));
}

#[test]
fn each_broken_obj_names_its_line() {
    let three = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let refused = |text: &str| rule(obj(&format!("{three}{text}"))).to_string();
    assert_eq!(refused("f 1 2 x"), "line 4: \"x\" is not a number");
    assert_eq!(refused("\n# note\nf 1 2 4"), "line 6 names number 4, but there are 3 above it");
    assert_eq!(refused("f 1 2 0"), "line 4 names number 0, but there are 3 above it");
    assert_eq!(refused("f 1 2 -4"), "line 4 names number -4, but there are 3 above it");
    assert_eq!(refused("f 1/1 2 3"), "line 4 names number 1, but there are 0 above it");
    assert_eq!(refused("f 1 2"), "face 0 has 2 corners, expected three or more");
    assert_eq!(refused("v 1 2"), "line 4 has 2 numbers, expected 3, 4, 6 or 7");
    assert_eq!(refused("vt"), "line 4 has 0 numbers, expected 1 to 3");
    assert_eq!(refused("v 1 2 3 1 1 1"), "1 colours for 4 vertices, expected one for each or none");
    assert!(refused("v 1 2 3 4 5 6").starts_with("vertex 3: a colour channel is 4"));
    let long = format!("# {}", "x".repeat(1 << 20));
    assert_eq!(refused(&long), "line 4 is longer than 1 MiB with its continuations");
}

#[test]
fn a_vertex_with_two_texture_coordinates_is_two_in_one_place() {
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvt 0.5 0.5\n\
                f 1/1 2/2 3/3\nf 2/4 4/1 3/3\nf 2/4 4/2 3/3\n";
    let (mesh, unused) = obj(text).unwrap();
    assert_eq!(mesh.faces, [[0, 1, 2], [4, 3, 2], [4, 5, 2]]);
    assert_eq!(mesh.vertices[4], mesh.vertices[1]);
    assert_eq!(mesh.vertices[5], mesh.vertices[3]);
    let uv = |index: usize| mesh.coordinates[index].to_array();
    assert_eq!([uv(1), uv(4), uv(3), uv(5)], [[1.0, 0.0], [0.5, 0.5], [0.0, 0.0], [1.0, 0.0]]);
    assert_eq!(unused.coordinates, 0);
    let (mesh, unused) = obj(&text.replace("f 2/4 4/1 3/3", "f 2 4 3")).unwrap();
    assert!(mesh.coordinates.is_empty());
    assert_eq!(unused.coordinates, 3);
}
