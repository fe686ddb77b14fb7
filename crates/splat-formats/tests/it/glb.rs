use crate::{Folder, encoded, scene};
use gs_scene::Gaussians;
use serde_json::{Value, json};
use splat_formats::{Format, Remark};

/// A glTF file in its two parts.
struct Glb {
    json: Value,
    binary: Vec<u8>,
}

impl Glb {
    fn new(scene: &Gaussians) -> Self {
        let bytes = encoded(scene, Format::Glb);
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let json = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        Self { json, binary: bytes[20 + length + 8..].to_vec() }
    }

    fn bytes(&self) -> Vec<u8> {
        let json = serde_json::to_vec(&self.json).unwrap();
        let word = |value: usize| (value as u32).to_le_bytes();
        let total = 28 + json.len() + self.binary.len();
        [
            b"glTF",
            &word(2)[..],
            &word(total),
            &word(json.len()),
            b"JSON",
            &json,
            &word(self.binary.len()),
            b"BIN\0",
            &self.binary,
        ]
        .concat()
    }

    fn with(mut self, pointer: &str, value: Value) -> Self {
        *self.json.pointer_mut(pointer).unwrap_or_else(|| panic!("{pointer}")) = value;
        self
    }
}

#[test]
fn the_file_is_what_the_extension_demands() {
    let bytes = encoded(&scene(2, 3, 1), Format::Glb);
    let file = Glb::new(&scene(2, 3, 1));
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((&bytes[..4], word(4), word(8)), (&b"glTF"[..], 2, bytes.len()));
    assert!(word(12) % 4 == 0 && file.binary.len().is_multiple_of(4));
    let json = &file.json;
    assert_eq!(json["extensionsUsed"], json!(["KHR_gaussian_splatting"]));
    let primitive = &json["meshes"][0]["primitives"][0];
    assert_eq!(primitive["mode"], 0);
    let extension = json!({"kernel": "ellipse", "colorSpace": "srgb_rec709_display"});
    assert_eq!(primitive["extensions"]["KHR_gaussian_splatting"], extension);
    let attributes = primitive["attributes"].as_object().unwrap();
    assert_eq!(attributes.len(), 2 + 3 + 9);
    for (degree, count) in [(0, 1), (1, 3), (2, 5)] {
        assert!((0..count).all(|n| {
            attributes.contains_key(&format!("KHR_gaussian_splatting:SH_DEGREE_{degree}_COEF_{n}"))
        }));
    }
    // Every accessor lies within its view, and the views fill the buffer.
    let views = json["bufferViews"].as_array().unwrap();
    let end = views
        .iter()
        .map(|view| view["byteOffset"].as_u64().unwrap() + view["byteLength"].as_u64().unwrap())
        .max();
    assert_eq!(end, Some(file.binary.len() as u64));
    assert_eq!(json["buffers"][0]["byteLength"], file.binary.len());
    let position = attributes["POSITION"].as_u64().unwrap() as usize;
    assert!(json["accessors"][position]["min"].as_array().unwrap().len() == 3);
}

#[test]
fn nodes_move_their_gaussians() {
    let folder = Folder::new();
    let plain = scene(1, 1, 9);
    let read = |node: Value| {
        let file = Glb::new(&plain);
        let parent = json!({"translation": [1.0, 2.0, 3.0], "scale": [2.0, 2.0, 2.0], "children": [1]});
        let mut node = node;
        node["mesh"] = json!(0);
        folder.read("x.glb", &file.with("/nodes", json!([parent, node])).bytes()).unwrap().gaussians
    };
    // glTF's x and y point the other way.
    let moved = read(json!({}));
    for (axis, (sign, shift)) in [(-1.0, 1.0), (-1.0, 2.0), (1.0, 3.0)].into_iter().enumerate() {
        let expected = 2.0 * plain.geometry()[axis] + sign * shift;
        assert!((moved.geometry()[axis] - expected).abs() < 1e-5);
        let grown = plain.geometry()[7 + axis] + 2.0_f32.ln();
        assert!((moved.geometry()[7 + axis] - grown).abs() < 1e-5);
    }
    // A quarter turn about z, as a quaternion and as a matrix of columns.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let turned = read(json!({"rotation": [0.0, 0.0, half, half]}));
    let matrix = read(json!({"matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}));
    let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(apart(turned.geometry(), matrix.geometry()) < 1e-5 && apart(turned.sh(), matrix.sh()) < 1e-5);
    // (x, y) to (-y, x), in either axes.
    assert!((turned.geometry()[0] - (-2.0 * plain.geometry()[1] - 1.0)).abs() < 1e-4);
    assert!(apart(turned.sh(), plain.sh()) > 0.01, "spherical harmonics turn as well");
    assert_eq!(turned.sh()[..3], plain.sh()[..3]);
}

#[test]
fn several_primitives_are_one_scene_and_meshes_are_told() {
    let folder = Folder::new();
    let mut file = Glb::new(&scene(1, 4, 3));
    let primitive = file.json["meshes"][0]["primitives"][0].clone();
    let mut flat = primitive.clone();
    let attributes = flat["attributes"].as_object_mut().unwrap();
    attributes.retain(|name, _| !name.contains("SH_DEGREE_1"));
    let triangles = json!({"attributes": {"POSITION": 0}});
    file.json["meshes"][0]["primitives"] = json!([flat, triangles, primitive]);
    let read = folder.read("x.glb", &file.bytes()).unwrap();
    assert_eq!((read.gaussians.len(), read.gaussians.sh_degree()), (8, 1));
    assert_eq!(read.remarks, [Remark::Primitives { count: 1 }]);
    assert!(read.gaussians.sh()[3..12].iter().all(|&value| value == 0.0));
}

#[test]
fn quantised_attributes_are_read() {
    let folder = Folder::new();
    let mut file = Glb::new(&scene(0, 2, 3));
    let start = file.binary.len();
    // Strides of 8 and 4 bytes; opacity 1/3 and 1, sizes 2, 3, 4.
    file.binary.extend([85, 0, 0, 0, 0, 0, 0, 0, 255, 0, 0, 0, 0, 0, 0, 0, 2, 3, 4, 0, 2, 3, 4, 0]);
    file.json["buffers"][0]["byteLength"] = json!(file.binary.len());
    let views = file.json["bufferViews"].as_array_mut().unwrap();
    let first = views.len();
    views.push(json!({"buffer": 0, "byteOffset": start, "byteLength": 16, "byteStride": 8}));
    views.push(json!({"buffer": 0, "byteOffset": start + 16, "byteLength": 8, "byteStride": 4}));
    let accessors = file.json["accessors"].as_array_mut().unwrap();
    let next = accessors.len();
    accessors.push(
        json!({"bufferView": first, "componentType": 5121, "normalized": true, "count": 2, "type": "SCALAR"}),
    );
    accessors.push(json!({"bufferView": first + 1, "componentType": 5121, "count": 2, "type": "VEC3"}));
    let attributes = &mut file.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["KHR_gaussian_splatting:OPACITY"] = json!(next);
    attributes["KHR_gaussian_splatting:SCALE"] = json!(next + 1);
    let read = folder.read("x.glb", &file.bytes()).unwrap().gaussians;
    assert!((gs_scene::sigmoid(read.geometry()[10]) - 1.0 / 3.0).abs() < 1e-6);
    assert_eq!(gs_scene::sigmoid(read.geometry()[21]), 1.0);
    assert_eq!(read.geometry()[7..10], [2.0_f32, 3.0, 4.0].map(f32::ln));
}

#[test]
fn broken_files_name_their_rule() {
    let folder = Folder::new();
    let refused = |pointer: &str, value: Value, expected: &str| {
        let file = Glb::new(&scene(1, 3, 2)).with(pointer, value);
        let message = folder.refused("x.glb", &file.bytes());
        assert!(message.starts_with("glTF: ") && message.contains(expected), "{pointer}: {message}");
    };
    let splatting = "/meshes/0/primitives/0/extensions/KHR_gaussian_splatting";
    let attributes = "/meshes/0/primitives/0/attributes";
    refused("/asset/version", json!("1.0"), "asset version \"1.0\"");
    refused("/scene", json!(7), "scene 7");
    refused("/nodes", json!([{"children": [0]}]), "node 0");
    refused("/nodes", json!([{"children": [5]}]), "node 5");
    refused("/nodes", json!([{"mesh": 3}]), "mesh 3");
    refused("/nodes", json!([{"mesh": 0, "scale": [1, 2, 1]}]), "node 0 mirrors");
    refused("/nodes", json!([{"mesh": 0, "scale": [-1, -1, -1]}]), "node 0 mirrors");
    refused("/nodes", json!([{"mesh": 0, "scale": [0, 0, 0]}]), "node 0 mirrors");
    refused("/nodes", json!([{}]), "no Gaussians");
    refused("/meshes", json!([{"primitives": [{"attributes": {}}]}]), "no Gaussians");
    refused("/meshes/0/primitives/0/mode", json!(4), "mode of a primitive");
    refused(&format!("{splatting}/kernel"), json!("box"), "kernel \"box\"");
    refused(&format!("{splatting}/colorSpace"), json!("lin_rec709_display"), "colour space");
    refused(splatting, json!({"kernel": "ellipse"}), "JSON is broken: missing field `colorSpace`");
    let packed =
        json!({"kernel": "ellipse", "colorSpace": "srgb_rec709_display", "extensions": {"PACKED": {}}});
    refused(splatting, packed, "extension \"PACKED\"");
    refused(attributes, json!({"POSITION": 0}), "\"KHR_gaussian_splatting:ROTATION\" is missing");
    refused(&format!("{attributes}/POSITION"), json!(99), "accessor 99");
    refused(&format!("{attributes}/POSITION"), json!(2), "type \"VEC4");
    refused("/accessors/0/componentType", json!(5125), "component type 5125");
    refused("/accessors/0/count", json!(4), "accessor 0 reaches beyond");
    refused("/accessors/0/count", json!(u64::MAX), "accessor 0 reaches beyond");
    refused("/accessors/0/count", json!(2), "number of Gaussians in an attribute is 3, expected 2");
    refused("/accessors/0/byteOffset", json!(u64::MAX), "accessor 0 reaches beyond");
    refused("/accessors/0/bufferView", json!(99), "buffer view 99");
    refused("/accessors/0/bufferView", Value::Null, "accessor without a buffer view");
    refused("/bufferViews/0/byteLength", json!(u64::MAX), "buffer view 0 reaches beyond");
    refused("/bufferViews/0/buffer", json!(1), "buffer 1");
    refused("/buffers/0", json!({"byteLength": 4, "uri": "x.bin"}), "buffer outside the file");
    let mut file = Glb::new(&scene(1, 3, 2));
    file.json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    assert!(folder.refused("x.glb", &file.bytes()).contains("required extension \"KHR_draco"));
    // A part of a degree.
    let mut file = Glb::new(&scene(1, 3, 2));
    let map = file.json.pointer_mut(attributes).unwrap().as_object_mut().unwrap();
    map.remove("KHR_gaussian_splatting:SH_DEGREE_1_COEF_1");
    assert!(folder.refused("x.glb", &file.bytes()).contains("SH_DEGREE_1_COEF_1\" is missing"));
    // Numbers that no Gaussian has.
    let mut file = Glb::new(&scene(1, 3, 2));
    file.binary[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(folder.refused("x.glb", &file.bytes()).contains("Gaussian 0: position is NaN"));
}

#[test]
fn a_small_file_does_not_become_a_huge_scene() {
    let folder = Folder::new();
    let mut file = Glb::new(&scene(0, 2000, 2));
    let primitive = file.json["meshes"][0]["primitives"][0].clone();
    file.json["meshes"][0]["primitives"] = json!(vec![primitive; 1000]);
    assert!(folder.refused("x.glb", &file.bytes()).contains("grows to more than 16 times its size"));
    let bytes = Glb::new(&scene(0, 1, 2)).bytes();
    let mut huge = bytes.clone();
    huge[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(folder.refused("x.glb", &huge).contains("length of the JSON"));
    let mut newer = bytes;
    newer[4] = 3;
    assert_eq!(folder.refused("x.glb", &newer), "glTF: version 3 is not supported, expected 2");
}
