use super::{camera, depth};
use glam::DVec3;
use scene_sim::{Finish, MeshSource, Pattern, Traced, render_view, replica_scene};
use std::fmt::Write;
use std::path::Path;

/// A wall at y = 2 in two quads, its left half red, its right half white; z is up.
fn write_room(folder: &Path) {
    let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 8\nproperty float x\nproperty float y\n\
        property float z\nproperty float nx\nproperty float ny\nproperty float nz\nproperty uchar red\n\
        property uchar green\nproperty uchar blue\nelement face 2\nproperty list uint8 int vertex_indices\nend_header\n"
        .to_vec();
    for (low, high, colour) in [(-4f32, 0f32, [255, 0, 0]), (0.0, 4.0, [255; 3])] {
        for (x, z) in [(low, -4f32), (high, -4.0), (high, 4.0), (low, 4.0)] {
            [x, 2.0, z, 0.0, -1.0, 0.0].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
            bytes.extend::<[u8; 3]>(colour);
        }
    }
    for first in [0i32, 4] {
        bytes.push(4);
        (first..first + 4).for_each(|index| bytes.extend(index.to_le_bytes()));
    }
    std::fs::write(folder.join("mesh.ply"), bytes).unwrap();
}

/// A square on the wall around x = `x`, with the fields that a real file has.
fn surface(x: f64, reflectivity: f64) -> String {
    let corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)];
    let boundary: Vec<String> = corners.iter().map(|(u, v)| format!("[{}, 2.0001, {v}]", x + u)).collect();
    let mut text = format!("{{\"centroid_w\": [{x}, 2, 0], \"plane_w\": [0, -1, 0, 2], \"boundary_w\": [");
    let _ = write!(
        text,
        "{}], \"boundary_mani\": [[0, 0]], \"reflectivity\": {reflectivity}}}",
        boundary.join(", ")
    );
    text
}

#[test]
fn a_room_has_its_colours_and_its_mirrors() {
    let folder = tempfile::tempdir().unwrap();
    write_room(folder.path());
    let bare = replica_scene(folder.path()).unwrap();
    assert_eq!(bare.meshes.len(), 1);
    assert_eq!(
        (bare.meshes[0].material.finish, bare.meshes[0].material.pattern),
        (Finish::Baked, Pattern::VertexColours)
    );
    let traced = Traced::load(&bare, folder.path()).unwrap();
    assert!(traced.dropped().is_empty());
    let view = render_view(&traced, &camera(DVec3::ZERO, DVec3::Y), 4, "room", 0).unwrap();
    assert!(depth(&view).data().iter().all(|d| (d - 2.0).abs() < 1e-6));

    std::fs::write(
        folder.path().join("glass.sur"),
        format!("[{}, {}]", surface(1.0, 0.08 / 1.04), surface(-1.0, 0.9)),
    )
    .unwrap();
    let scene = replica_scene(folder.path()).unwrap();
    let [_, pane, mirror] = scene.meshes.as_slice() else { panic!("a scan and two surfaces") };
    assert_eq!((pane.name.as_str(), mirror.name.as_str()), ("pane 0", "mirror 1"));
    let Finish::Glass { index } = pane.material.finish else { panic!("a pane is of glass") };
    assert!((index - 1.5).abs() < 1e-12);
    assert_eq!(mirror.material.finish, Finish::Mirror);
    // Lifted off the wall by 2.5 mm, whatever side of its plane the outline was on.
    let traced = Traced::load(&scene, folder.path()).unwrap();
    for (x, expected) in [(1.0, 1.9975), (-1.0, 1.9975), (3.0, 2.0)] {
        let found = traced.distance(DVec3::new(x, 0.0, 0.1), DVec3::Y).unwrap();
        assert!((found - expected).abs() < 1e-9, "{found} at {x}");
    }
    let MeshSource::Inline { faces, .. } = &mirror.source else { panic!("in the description") };
    assert_eq!(faces, &[[0, 1, 2, 3]]);
}

#[test]
fn broken_rooms_name_file_surface_and_field() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("glass.sur");
    let message = replica_scene(folder.path()).unwrap_err().to_string();
    assert_eq!(message, format!("{}: cannot read", folder.path().join("mesh.ply").display()));
    write_room(folder.path());
    let refused = |text: &str| {
        std::fs::write(&path, text).unwrap();
        let message = replica_scene(folder.path()).unwrap_err().to_string();
        message.strip_prefix(&format!("{}: ", path.display())).expect("names the file").to_owned()
    };
    assert_eq!(refused("{}"), "not a list of mirrors and panes");
    assert_eq!(refused(&"[".repeat(100_000)), "not a list of mirrors and panes");
    let two = |second: &str| format!("[{}, {second}]", surface(0.0, 0.5));
    assert_eq!(refused(&two(&surface(0.0, 1.5))), "surface 1: reflectivity is 1.5, expected 0 to 1");
    let flat = surface(0.0, 0.5).replace("[0, -1, 0, 2]", "[0, 0, 0, 2]");
    assert!(refused(&two(&flat)).starts_with("surface 1: length of the normal in plane_w is 0"));
    let none = "{\"plane_w\": [0, 1, 0, 2], \"boundary_w\": [], \"reflectivity\": 1}";
    assert_eq!(refused(&two(none)), "surface 1: number of points in boundary_w is 0, expected 3 or more");
}
