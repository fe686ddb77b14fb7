use super::{GREY, SUN, body, camera, scene};
use glam::DVec3;
use scene_sim::{
    Error, Finish, Lamp, Mesh, MeshSource, Pattern, Scene, Shape, Sun, Traced, demo_scene, render_view,
};

fn message(scene: &Scene) -> String {
    Traced::new(scene).err().expect("the scene is refused").to_string()
}

#[test]
fn a_wrong_number_is_an_error_that_names_its_place() {
    let ball = || body("globe", Shape::Sphere { radius: 1.0 }, DVec3::ZERO, GREY);
    let with = |change: fn(&mut scene_sim::Primitive)| {
        let mut second = ball();
        change(&mut second);
        message(&scene(vec![ball(), second], None))
    };
    assert_eq!(
        with(|p| p.centre.y = f64::NAN),
        "primitive 1 (globe): centre is NaN, expected finite numbers of magnitude up to 1e9"
    );
    assert_eq!(
        with(|p| p.shape = Shape::Sphere { radius: -1.0 }),
        "primitive 1 (globe): radius is -1, expected 0 to 1e9"
    );
    assert!(
        with(|p| p.shape = Shape::Box { size: DVec3::INFINITY })
            .starts_with("primitive 1 (globe): size is inf")
    );
    assert!(with(|p| p.rotation.x = f64::INFINITY).contains("rotation is inf"));
    assert!(with(|p| p.material.mottle = 2.0).contains("mottle is 2, expected 0 to 1"));
    assert!(
        with(|p| p.material.pattern = Pattern::Plain { colour: [0.0, f32::NAN, 0.0] })
            .contains("colour is NaN")
    );
    let checker = |p: &mut scene_sim::Primitive| {
        p.material.pattern = Pattern::Checker { colours: [[0.0; 3]; 2], cell: 0.0 };
    };
    assert!(with(checker).ends_with("cell is 0, expected 1e-6 to 1e9"));
    let octaves = |p: &mut scene_sim::Primitive| {
        p.material.pattern = Pattern::Noise { dark: [0.0; 3], light: [0.0; 3], scale: 1.0, octaves: 0 };
    };
    assert!(with(octaves).ends_with("octaves is 0, expected 1 to 12"));
    let sun = Sun { towards: DVec3::ZERO, ..SUN };
    assert_eq!(message(&scene(vec![], Some(sun))), "sun: length of towards is 0, expected more than 0");
    let mut bright = scene(vec![], None);
    bright.sky.light = f32::INFINITY;
    assert_eq!(message(&bright), "sky: light is inf, expected 0 to 1e6");
}

#[test]
fn wrong_meshes_and_lamps_are_errors_that_name_place_and_rule() {
    let mesh = |source| Mesh {
        name: "chair".into(),
        source,
        centre: DVec3::ZERO,
        rotation: DVec3::ZERO,
        scale: 1.0,
        material: body("", Shape::Sphere { radius: 1.0 }, DVec3::ZERO, GREY).material,
    };
    let with = |change: fn(&mut Mesh)| {
        let vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let mut chair =
            mesh(MeshSource::Inline { vertices, faces: vec![vec![0, 1, 2]], colours: vec![[0.5; 3]; 3] });
        change(&mut chair);
        message(&Scene { meshes: vec![chair], ..scene(vec![], None) })
    };
    fn inline(mesh: &mut Mesh) -> (&mut Vec<DVec3>, &mut Vec<Vec<u32>>, &mut Vec<[f32; 3]>) {
        match &mut mesh.source {
            MeshSource::Inline { vertices, faces, colours } => (vertices, faces, colours),
            MeshSource::File(_) => unreachable!("made inline"),
        }
    }
    assert_eq!(with(|m| m.scale = 0.0), "mesh 0 (chair): scale is 0, expected 1e-6 to 1e9");
    assert!(with(|m| inline(m).0[1].z = f64::NAN).starts_with("mesh 0 (chair): vertices is NaN"));
    assert!(with(|m| inline(m).2[1][0] = 2.0).starts_with("mesh 0 (chair): colours is 2"));
    assert_eq!(
        with(|m| inline(m).2.truncate(2)),
        "mesh 0 (chair): 2 colours for 3 vertices, expected one for each or none"
    );
    assert_eq!(
        with(|m| inline(m).1.push(vec![0, 3, 1])),
        "mesh 0 (chair): face 1 names vertex 3, but there are 3"
    );
    assert_eq!(
        with(|m| inline(m).1.push(vec![0, 1])),
        "mesh 0 (chair): face 1 has 2 corners, expected three or more"
    );
    assert_eq!(
        with(|m| m.source = MeshSource::File("chair.ply".into())),
        "mesh 0 (chair): its polygons are in a file, which needs the folder of the description (Traced::load)"
    );
    assert_eq!(
        with(|m| m.material.finish = Finish::Glass { index: 0.5 }),
        "mesh 0 (chair): index is 0.5, expected 1 to 3"
    );
    let lamp = Lamp {
        name: "ceiling".into(),
        centre: DVec3::ZERO,
        rotation: DVec3::ZERO,
        size: glam::DVec2::new(1.0, -1.0),
        colour: [1.0; 3],
        strength: 1.0,
    };
    let lit = Scene { lamps: vec![lamp], ..scene(vec![], None) };
    assert_eq!(message(&lit), "lamp 0 (ceiling): size is -1, expected 0 to 1e9");
    let old = Scene { version: 7, ..scene(vec![], None) };
    assert_eq!(message(&old), "the description has version 7, only version 1 is read");
}

#[test]
fn a_view_needs_samples() {
    let traced = Traced::new(&scene(vec![], None)).unwrap();
    let camera = camera(DVec3::ZERO, DVec3::Y);
    for found in [0, 4097, u32::MAX] {
        let error = render_view(&traced, &camera, found, "view", 0).unwrap_err();
        assert!(matches!(error, Error::Samples { found: f } if f == found));
    }
}

#[test]
fn a_scene_survives_a_file_and_unknown_fields_are_errors() {
    let scene = demo_scene();
    let text = serde_json::to_string(&scene).unwrap();
    assert_eq!(serde_json::from_str::<Scene>(&text).unwrap(), scene);
    let error = serde_json::from_str::<Scene>(&text.replacen("\"sky\"", "\"ski\"", 1)).unwrap_err();
    assert!(error.to_string().contains("ski"));
}

#[test]
fn the_largest_and_smallest_numbers_allowed_render() {
    let view_of = |shape, centre: DVec3, pattern| {
        let traced = Traced::new(&scene(vec![body("x", shape, centre, pattern)], Some(SUN))).unwrap();
        let view = render_view(&traced, &camera(centre - DVec3::Y * 3.0, centre), 4, "view", 0).unwrap();
        assert!(view.image().data().iter().all(|v| (0.0..=1.0).contains(v)), "{shape:?}");
    };
    let checker = |cell| Pattern::Checker { colours: [[0.0; 3], [1.0; 3]], cell };
    view_of(Shape::Sphere { radius: 1e9 }, DVec3::splat(1e9), checker(1e-6));
    view_of(Shape::Box { size: DVec3::splat(1e9) }, DVec3::splat(-1e9), checker(1e9));
    view_of(Shape::Sphere { radius: 1e-9 }, DVec3::ZERO, checker(1e-6));
    let wood = |plank| Pattern::Wood { light: [1.0; 3], dark: [0.0; 3], plank };
    view_of(Shape::Box { size: DVec3::ONE }, DVec3::ZERO, wood(1e-6));
    let print = |line| Pattern::Print { paper: [1.0; 3], ink: [0.0; 3], accent: [0.5; 3], line };
    view_of(Shape::Box { size: DVec3::ONE }, DVec3::ZERO, print(1e-6));
    view_of(Shape::Box { size: DVec3::ONE }, DVec3::ZERO, print(1e9));
    let brick =
        |length, joint| Pattern::Brick { brick: [0.5; 3], mortar: [1.0; 3], length, height: 0.1, joint };
    view_of(Shape::Cylinder { radius: 0.5, height: 1.0 }, DVec3::ZERO, brick(1e-6, 0.0));
    view_of(Shape::Cylinder { radius: 0.5, height: 1.0 }, DVec3::ZERO, brick(0.2, 1e9));
}
