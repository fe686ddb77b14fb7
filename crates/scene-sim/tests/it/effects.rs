use super::photographs::{BARREL, grey_wall, plain, take, wall};
use super::{GREY, SKY, SUN, body, depth, scene};
use glam::{DVec2, DVec3};
use gs_scene::Distortion;
use scene_sim::{
    Aperture, Exposure, Finish, Lamp, Occlusion, Photographs, RayCounts, Scene, SensorNoise, Shape, Sky, Sun,
    Traced, Trajectory, photograph, photograph_with_light,
};

/// Everything at once, in a scene with every effect of light.
fn everything() -> (Scene, Photographs) {
    let mut mirror = wall(0.5, 3.0, 0.9);
    mirror.material.finish = Finish::Mirror;
    let mut glass = body("ball", Shape::Sphere { radius: 0.5 }, DVec3::new(-0.4, 2.5, 0.0), GREY);
    glass.material.finish = Finish::Glass { index: 1.5 };
    let floor = body("floor", Shape::Rectangle { width: 20.0, height: 20.0 }, DVec3::Z * -1.0, GREY);
    let lamp = Lamp {
        name: "lamp".into(),
        centre: DVec3::new(-1.0, 2.0, 3.0),
        rotation: DVec3::X * 180.0,
        size: DVec2::ONE,
        colour: [1.0; 3],
        strength: 2.0,
    };
    let lit = Scene {
        lamps: vec![lamp],
        sky: Sky { occlusion: Some(Occlusion { reach: 1.0, rays: 2 }), ..SKY },
        ..scene(vec![mirror, glass, floor], Some(Sun { diameter: 3.0, ..SUN }))
    };
    let photographs = Photographs {
        distortion: Some(BARREL),
        aperture: Some(Aperture { diameter: 0.05, focus: 3.0 }),
        motion_blur: Some(0.5),
        rolling_shutter: Some(0.5),
        exposure: Some(Exposure { stops: 0.2, white_balance: 0.1 }),
        noise: Some(SensorNoise { full_well: 2000.0, read: 10.0 }),
        ..plain()
    };
    (lit, photographs)
}

#[test]
fn an_effect_that_is_not_called_for_takes_nothing() {
    type Count = fn(&RayCounts) -> u64;
    let kinds: [(&str, Count); 12] = [
        ("shadow", |c| c.shadow),
        ("lamp_shadow", |c| c.lamp_shadow),
        ("occlusion", |c| c.occlusion),
        ("mirror", |c| c.mirror),
        ("reflection", |c| c.reflection),
        ("refraction", |c| c.refraction),
        ("distorted", |c| c.distorted),
        ("lens_points", |c| c.lens_points),
        ("moments", |c| c.moments),
        ("row_poses", |c| c.row_poses),
        ("gains", |c| c.gains),
        ("noise", |c| c.noise),
    ];
    type Without = fn(&mut Scene, &mut Photographs);
    let cases: [(&[&str], Without); 11] = [
        (&[], |_, _| ()),
        (&["shadow"], |s, _| s.sun = None),
        (&["lamp_shadow"], |s, _| s.lamps.clear()),
        (&["occlusion"], |s, _| s.sky.occlusion = None),
        (&["mirror"], |s, _| s.primitives[0].material.finish = Finish::Matte),
        (&["reflection", "refraction"], |s, _| s.primitives[1].material.finish = Finish::Matte),
        (&["distorted"], |_, p| p.distortion = None),
        (&["lens_points"], |_, p| p.aperture = None),
        (&["moments"], |_, p| p.motion_blur = None),
        (&["row_poses"], |_, p| p.rolling_shutter = None),
        (&["gains"], |_, p| p.exposure = None),
    ];
    let check = |absent: &[&str], scene: &Scene, photographs: &Photographs| {
        let rays = take(&Traced::new(scene).unwrap(), photographs, 1).rays;
        assert_eq!((rays.primary, rays.depth), (81 * 61 * 4, 81 * 61));
        for (name, count) in kinds {
            assert_eq!(
                count(&rays) == 0,
                absent.contains(&name),
                "{name} without {absent:?}: {}",
                count(&rays)
            );
        }
    };
    let without = |absent: &[&str], without: Without| {
        let (mut scene, mut photographs) = everything();
        without(&mut scene, &mut photographs);
        check(absent, &scene, &photographs);
    };
    for (absent, change) in cases {
        without(absent, change);
    }
    without(&["noise"], |_, p| p.noise = None);
    // An effect of size 0 is none, and a scene with nothing at all takes nothing but its two kinds of camera rays.
    without(&["distorted", "lens_points", "moments", "row_poses", "gains", "occlusion"], |s, p| {
        p.distortion = Some(Distortion::default());
        p.aperture = Some(Aperture { diameter: 0.0, focus: 1.0 });
        (p.motion_blur, p.rolling_shutter) = (Some(0.0), Some(0.0));
        p.exposure = Some(Exposure { stops: 0.0, white_balance: 0.0 });
        s.sky.light = 0.0;
    });
    let all: Vec<&str> = kinds.iter().map(|(name, _)| *name).collect();
    check(&all, &scene(vec![wall(-5.0, 3.0, 0.5)], None), &plain());
}

#[test]
fn photographs_are_the_same_on_any_number_of_threads() {
    let (scene, photographs) = everything();
    let traced = Traced::new(&scene).unwrap();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let taken = pool.install(|| photograph_with_light(&traced, &photographs, 2, 9).unwrap());
        let bits = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        let light = taken.light.unwrap();
        (bits(taken.view.image().data()), bits(depth(&taken.view).data()), bits(light.data()), taken.rays)
    };
    let one = on(1);
    for threads in [2, 5] {
        assert!(on(threads) == one, "{threads} threads differ");
    }
    assert!(one.0.iter().all(|bits| (0.0..=1.0).contains(&f32::from_bits(*bits))));
}

#[test]
fn wrong_photographs_and_lights_are_errors_that_name_the_field() {
    let traced = grey_wall(0.5);
    let message = |change: fn(&mut Photographs)| {
        let mut photographs = plain();
        change(&mut photographs);
        let refused = photographs.check().unwrap_err().to_string();
        assert_eq!(photograph(&traced, &photographs, 0, 0).unwrap_err().to_string(), refused);
        let described = Scene { photographs: Some(photographs), ..scene(vec![], None) };
        assert_eq!(Traced::new(&described).err().unwrap().to_string(), refused);
        refused
    };
    assert_eq!(message(|p| p.width = 0), "photographs: width is 0, expected 1 to 32768 pixels");
    assert!(message(|p| p.height = usize::MAX).starts_with("photographs: height is 1844"));
    assert!(message(|p| p.field_of_view = f64::NAN).contains("field_of_view is NaN"));
    assert!(message(|p| p.field_of_view = 180.0).contains("field_of_view is 180"));
    assert!(message(|p| p.count = 0).contains("count is 0"));
    assert!(message(|p| p.samples = 0).contains("samples per pixel are 0"));
    assert!(
        message(|p| p.path = Trajectory::Walk { target: DVec3::Y, from: DVec3::NAN, to: DVec3::X })
            .starts_with("trajectory: from is NaN")
    );
    assert!(message(|p| p.distortion = Some(Distortion { k2: f64::NAN, ..BARREL })).contains("k2 is NaN"));
    assert!(message(|p| p.distortion = Some(Distortion { p1: 1e300, ..BARREL })).contains("p1 is 1"));
    assert!(
        message(|p| p.aperture = Some(Aperture { diameter: -1.0, focus: 1.0 }))
            .contains("diameter of the ap")
    );
    assert!(
        message(|p| p.aperture = Some(Aperture { diameter: 0.1, focus: 0.0 }))
            .contains("focus of the aperture is 0")
    );
    assert!(message(|p| p.motion_blur = Some(f64::INFINITY)).contains("motion_blur is inf, expected 0 to 1"));
    assert!(message(|p| p.rolling_shutter = Some(-0.1)).contains("rolling_shutter is -0.1"));
    assert!(
        message(|p| p.exposure = Some(Exposure { stops: f64::NAN, white_balance: 0.0 }))
            .contains("stops is NaN")
    );
    assert!(
        message(|p| p.exposure = Some(Exposure { stops: 0.0, white_balance: -1.0 }))
            .contains("white_balance is -1")
    );
    assert!(
        message(|p| p.noise = Some(SensorNoise { full_well: 0.0, read: 0.0 })).contains("full_well is 0")
    );
    assert!(
        message(|p| p.noise = Some(SensorNoise { full_well: 1e3, read: f64::NAN })).contains("read is NaN")
    );
    assert!(
        message(|p| p.pose_error = Some(f64::NAN)).contains("pose_error is NaN, expected 0 to 10 degrees")
    );
    assert_eq!(
        photograph(&traced, &plain(), 5, 0).unwrap_err().to_string(),
        "photographs: picture 5 is asked for, there are 5, counted from 0"
    );

    let message = |change: fn(&mut Scene)| {
        let mut scene = everything().0;
        change(&mut scene);
        Traced::new(&scene).err().expect("the scene is refused").to_string()
    };
    assert_eq!(message(|s| s.lamps[0].size.x = -1.0), "lamp 0 (lamp): size is -1, expected 0 to 1e9");
    assert!(message(|s| s.lamps[0].centre.x = f64::NAN).starts_with("lamp 0 (lamp): centre is NaN"));
    assert!(message(|s| s.lamps[0].rotation.z = f64::INFINITY).contains("rotation is inf"));
    assert!(message(|s| s.lamps[0].strength = -0.5).contains("strength is -0.5"));
    assert!(message(|s| s.lamps[0].colour[2] = f32::NAN).contains("colour is NaN"));
    let diameter = |s: &mut Scene, d| s.sun = Some(Sun { diameter: d, ..SUN });
    assert!(diameter_message(diameter, -1.0).contains("sun: diameter is -1"));
    assert!(diameter_message(diameter, f64::NAN).contains("sun: diameter is NaN"));
    assert!(
        message(|s| s.sky.occlusion = Some(Occlusion { reach: -1.0, rays: 4 }))
            .contains("reach of the occlusion is -1")
    );
    assert!(
        message(|s| s.sky.occlusion = Some(Occlusion { reach: 1.0, rays: 0 }))
            .contains("rays of the occlusion is 0")
    );
    for (index, text) in [(0.5, "0.5"), (f64::NAN, "NaN"), (1e9, "1000000000")] {
        let mut scene = everything().0;
        scene.primitives[1].material.finish = Finish::Glass { index };
        let message = Traced::new(&scene).err().unwrap().to_string();
        assert_eq!(message, format!("primitive 1 (ball): index is {text}, expected 1 to 3"));
    }
}

fn diameter_message(change: impl Fn(&mut Scene, f64), diameter: f64) -> String {
    let mut scene = everything().0;
    change(&mut scene, diameter);
    Traced::new(&scene).err().expect("the scene is refused").to_string()
}
