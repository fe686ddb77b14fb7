use super::{GREY, SUN, body, scene};
use glam::{DVec2, DVec3};
use scene_sim::{
    Finish, Lamp, Mesh, MeshSource, Occlusion, Scene, Shape, Sky, Traced, demo_scene, read_scene,
    varied_scene, write_scene,
};
use std::path::Path;

fn mesh(file: &str) -> Mesh {
    let material = body("", Shape::Sphere { radius: 1.0 }, DVec3::ZERO, GREY).material;
    let source = MeshSource::File(file.into());
    Mesh { name: "chair".into(), source, centre: DVec3::Z, rotation: DVec3::X, scale: 0.5, material }
}

/// A scene with every kind of part.
fn everything() -> Scene {
    let mut inline = mesh("");
    let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y * 0.1];
    inline.source =
        MeshSource::Inline { vertices, faces: vec![vec![0, 1, 2]], colours: vec![[0.1, 0.2, 0.3]; 3] };
    inline.material.finish = Finish::Glass { index: 1.5 };
    let lamp = Lamp {
        name: "a \"lamp\"".into(),
        centre: DVec3::new(1e-3, -1e9, 0.1),
        rotation: DVec3::ZERO,
        size: DVec2::new(0.5, 0.25),
        colour: [1.0, 0.9, 0.8],
        strength: 3.0,
    };
    let mut all = demo_scene();
    all.meshes = vec![mesh("chairs/one.ply"), inline];
    all.lamps = vec![lamp];
    all.sun = Some(SUN);
    all.sky = Sky { occlusion: Some(Occlusion { reach: 1.5, rays: 16 }), ..all.sky };
    all
}

#[test]
fn every_scene_survives_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep/scene.ron");
    let scenes = [everything(), demo_scene(), Scene::under(demo_scene().sky)]
        .into_iter()
        .chain((0..20).map(varied_scene));
    for scene in scenes {
        write_scene(&path, &scene).unwrap();
        assert_eq!(read_scene(&path).unwrap(), scene);
    }
}

#[test]
fn a_description_by_hand_needs_only_what_is_there() {
    let text = "(
        version: 1,
        primitives: [(
            name: \"ball\", shape: Sphere(radius: 0.5), centre: (0, 0, 1),
            material: (pattern: Plain(colour: (0.8, 0.2, 0.1))),
        )],
        sun: (towards: (1, 0, 2), colour: (1, 1, 1), strength: 0.8),
        sky: (zenith: (0.3, 0.5, 0.9), horizon: (0.8, 0.9, 1), ground: (0.4, 0.4, 0.4), light: 0.5),
    )";
    let scene = Scene::from_ron(text).unwrap();
    assert_eq!(scene.primitives[0].shape, Shape::Sphere { radius: 0.5 });
    assert_eq!(scene.sun.unwrap().towards, DVec3::new(1.0, 0.0, 2.0));
    assert!(scene.photographs.is_none());
}

#[test]
fn a_wrong_description_names_file_place_and_rule() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.ron");
    let refused = |text: &str| {
        std::fs::write(&path, text).unwrap();
        let message = read_scene(&path).unwrap_err().to_string();
        message.strip_prefix(&format!("{}: ", path.display())).expect("names the file").to_owned()
    };
    let sound = scene(vec![body("globe", Shape::Sphere { radius: 1.0 }, DVec3::ZERO, GREY)], None).to_ron();
    let other = sound.replacen("version: 1", "version: 9", 1).replacen("sky:", "weather:", 1);
    assert_eq!(refused(&other), "the description has version 9, only version 1 is read");
    let message = refused(&sound.replacen("sky:", "ski:", 1));
    assert!(message.starts_with("line ") && message.contains("ski"), "{message}");
    assert!(refused("(version: 1,\n  sky: 7)").starts_with("line 2, column "));
    assert!(
        refused(&sound.replacen("radius: 1.0", "radius: -1.0", 1))
            .contains("primitive 0 (globe): radius is -1")
    );
    assert!(refused(&"(".repeat(100_000)).starts_with("line 1, column"));
    assert!(refused("").starts_with("line 1, column 1"));
    let missing = folder.path().join("nothing.ron");
    assert_eq!(read_scene(&missing).unwrap_err().to_string(), format!("{}: cannot read", missing.display()));
}

fn load(folder: &Path, file: &str) -> scene_sim::Result<Traced> {
    Traced::load(&Scene { meshes: vec![mesh(file)], ..scene(vec![], None) }, folder)
}

#[test]
fn a_mesh_from_a_file_stands_in_its_place() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("parts")).unwrap();
    let square = "v -4 -4 0\nv 4 -4 0\nv 4 4 0\nv -4 4 0\nusemtl oak\nf 1 2 3 4\nf 1 1 2\n";
    std::fs::write(folder.path().join("parts/square.OBJ"), square).unwrap();
    let traced = load(folder.path(), "parts/square.OBJ").unwrap();
    // Turned by one degree about x, 1 m above the origin, half as large.
    let hit = traced.distance(DVec3::new(1.5, 1.0, 5.0), -DVec3::Z).unwrap();
    assert!((hit - (4.0 - 1f64.to_radians().tan())).abs() < 1e-12);
    assert!(traced.distance(DVec3::new(2.1, 0.0, 5.0), -DVec3::Z).is_none());
    let dropped: Vec<String> = traced.dropped().iter().map(ToString::to_string).collect();
    assert_eq!(
        dropped,
        [
            "mesh 0 (chair): 1 lines that name materials are ignored",
            "mesh 0 (chair): 1 triangles have two corners in one place"
        ]
    );
}

#[test]
fn a_broken_mesh_file_names_mesh_file_and_rule() {
    let folder = tempfile::tempdir().unwrap();
    let refused = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let message = load(folder.path(), name).err().expect("the file is refused").to_string();
        let start = format!("mesh 0 (chair): {}: ", path.display());
        message.strip_prefix(&start).expect("names mesh and file").to_owned()
    };
    assert_eq!(refused("a.stl", "solid"), "the file's extension is \"stl\", expected ply or obj");
    assert_eq!(refused("a.ply", "solid"), "not a PLY file (the first line is not \"ply\")");
    assert_eq!(refused("a.obj", "v 1 2 3\nf 1 2 3"), "line 2 names number 2, but there are 1 above it");
    let far = "vertex 0: a coordinate is 2000000000, expected a finite number of magnitude up to 1e9 metres";
    assert_eq!(refused("b.obj", "v 4e9 0 0"), far);
    assert!(refused("c.obj", "v 0 nan 0").starts_with("vertex 0: a coordinate is NaN"));
    let inf = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt inf\nf 1/1 2/1 3/1";
    assert!(refused("d.obj", inf).starts_with("vertex 0: a texture coordinate"));
    let path = folder.path().join("none.ply");
    let message = load(folder.path(), "none.ply").err().expect("there is no file").to_string();
    assert_eq!(message, format!("{}: cannot read", path.display()));
}
