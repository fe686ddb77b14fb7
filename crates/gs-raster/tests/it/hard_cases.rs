//! What breaks renderers, case by case; shared with the example `hard_cases`, which prints the table of docs/numerics.md.

use crate::fixtures::cases;
use crate::hard_case::HardCase;
use crate::losses::noise;
use glam::{DMat3, DVec3, EulerRot};
use gs_reference::Profile;
use gs_scene::{Camera, Gaussians, Intrinsics};

const LENS: Intrinsics = Intrinsics { fx: 30.0, fy: 28.0, cx: 13.0, cy: 9.0, width: 27, height: 18 };
/// A row of geometry that is drawn: mean, quaternion, log scales, logit.
const GOOD: [f32; 11] = [0.1, 0.1, 2.0, 1.0, 0.2, 0.1, 0.3, -1.5, -1.0, -2.0, 1.0];

/// All of them.
pub(crate) fn hard_cases() -> Vec<HardCase> {
    [values(), shapes(), crowds(), places(), sizes(), golden()].into_iter().flatten().collect()
}

fn camera() -> Camera {
    Camera::new(LENS, DMat3::IDENTITY, DVec3::ZERO).expect("valid")
}

fn of_rows(rows: &[[f32; 11]]) -> Gaussians {
    let sh = rows.iter().flat_map(|_| [0.5, 0.1, -0.2]).collect();
    Gaussians::new(0, rows.as_flattened().to_vec(), sh).expect("valid")
}

fn with(column: usize, value: f32) -> [f32; 11] {
    let mut row = GOOD;
    row[column] = value;
    row
}

fn turned(quaternion: [f32; 4]) -> [f32; 11] {
    let mut row = GOOD;
    row[3..7].copy_from_slice(&quaternion);
    row
}

fn sized(log_scales: [f32; 3]) -> [f32; 11] {
    let mut row = GOOD;
    row[7..10].copy_from_slice(&log_scales);
    row
}

fn drawn(name: &str, happens: &'static str, scene: Gaussians) -> HardCase {
    HardCase {
        name: name.to_owned(),
        happens,
        scene,
        camera: camera(),
        profile: Profile::default(),
        rejected: 0,
        is_drawn: true,
        ambiguous: None,
    }
}

fn background(name: &str, happens: &'static str, scene: Gaussians) -> HardCase {
    HardCase { is_drawn: false, ..drawn(name, happens, scene) }
}

fn values() -> Vec<HardCase> {
    let mut broken = vec![GOOD];
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        broken.extend((0..11).map(|column| with(column, bad)));
    }
    let mut colours = of_rows(&[GOOD; 4]);
    colours.buffers_mut().1[3..12].copy_from_slice(&[
        f32::NAN,
        0.0,
        0.0,
        0.0,
        f32::INFINITY,
        0.0,
        0.0,
        0.0,
        f32::NEG_INFINITY,
    ]);
    let mut negative = of_rows(&[GOOD]);
    negative.buffers_mut().1.copy_from_slice(&[-9.0, -1.0, 0.5]);
    let mut bright = of_rows(&[GOOD]);
    bright.buffers_mut().1.copy_from_slice(&[1e8, 1e4, 1.0]);
    let tiny = [1e-40, -1e-40, f32::MIN_POSITIVE, 1e-30];
    let denormal: Vec<[f32; 11]> = (0..11)
        .filter(|&column| column != 2)
        .flat_map(|column| tiny.map(|value| with(column, value)))
        .collect();
    let norms: Vec<[f32; 11]> = [1e-30, 1e-12, 1e-6, 1e6, 1e18, 1e30]
        .map(|norm| turned([norm, -0.5 * norm, 0.1 * norm, 0.3 * norm]))
        .to_vec();
    vec![
        HardCase {
            rejected: 33,
            ..drawn(
                "NaN or infinity in a column",
                "left out and counted; the neighbour is drawn",
                of_rows(&broken),
            )
        },
        HardCase { rejected: 3, ..drawn("NaN or infinity in a colour", "left out and counted", colours) },
        drawn("denormal and tiny numbers", "as zeros", of_rows(&denormal)),
        HardCase {
            rejected: 1,
            ..drawn("zero quaternion", "left out and counted", of_rows(&[turned([0.0; 4]), GOOD]))
        },
        drawn("quaternions of norms 1e-30 to 1e30", "directions like any other", of_rows(&norms)),
        HardCase {
            rejected: 2,
            ..drawn(
                "scales beyond f32",
                "left out and counted",
                of_rows(&[with(7, 88.8), with(8, 1e30), GOOD]),
            )
        },
        drawn("logit 1e4", "alpha is cut at 0.99, without gradient there", of_rows(&[with(10, 1e4)])),
        background("logit -1e4", "not drawn", of_rows(&[with(10, -1e4)])),
        background("opacity under 1/255", "not drawn", of_rows(&[with(10, -5.5375), with(10, -5.6)])),
        drawn(
            "opacity over 1/255",
            "a spot in the middle of the footprint",
            of_rows(&[with(10, -5.53), with(10, -5.5)]),
        ),
        drawn("colours under 0", "drawn as 0, without gradient", negative),
        drawn("colours of 1e8", "drawn", bright),
    ]
}

fn shapes() -> Vec<HardCase> {
    let angles = 0..24;
    let needles = |long: f32, thin: f32| -> Vec<[f32; 11]> {
        angles
            .clone()
            .map(|i| {
                let half = i as f32 * std::f32::consts::PI / 24.0;
                let mut row = sized([long, thin, thin]);
                row[..3].copy_from_slice(&[0.2 * noise(1, i), 0.2 * noise(2, i), 2.0 + 0.05 * i as f32]);
                row[3..7].copy_from_slice(&[half.cos(), 0.3 * noise(3, i), 0.3 * noise(4, i), half.sin()]);
                row
            })
            .collect()
    };
    let tiny = [-9.0, -20.0, -60.0, -100.0, -1e30].map(|log_scale| sized([log_scale; 3]));
    let mut apart = of_rows(&tiny);
    for (i, row) in apart.buffers_mut().0.chunks_exact_mut(11).enumerate() {
        // In the middle of pixels, opaque: the least compensation leaves little more than 1/255.
        let (i, z) = (i as f32, 2.0 + 0.1 * i as f32);
        (row[0], row[1], row[2], row[10]) = ((4.0 * i - 8.5) / 30.0 * z, (i - 0.5) / 28.0 * z, z, 6.0);
    }
    let antialias = Profile { antialias: true, ..Profile::default() };
    vec![
        drawn("needles 1 : 1e4, across", "drawn", of_rows(&needles(-0.5, -9.7))),
        drawn("needles 1 : 1e5, σ of 1600 px", "drawn", of_rows(&needles(4.7, -6.8))),
        drawn("discs 1e4 : 1, edge-on and not", "drawn", of_rows(&needles(-9.7, -0.5))),
        drawn("scales under 1e-3 px", "the low-pass filter's spot", apart.clone()),
        HardCase {
            profile: antialias,
            ..drawn("the same, antialias", "fainter by the least compensation", apart)
        },
        drawn(
            "scales of e^10 to e^88",
            "cover everything",
            of_rows(&[sized([10.0; 3]), sized([40.0; 3]), sized([69.0; 3]), sized([88.0; 3])]),
        ),
    ]
}

fn crowds() -> Vec<HardCase> {
    let stack = |n: usize, logit: f32| -> Gaussians {
        let rows: Vec<[f32; 11]> = (0..n)
            .map(|i| {
                let mut row = sized([-0.5, -0.5, -1.0]);
                (row[2], row[10]) = (2.0 + 0.01 * ((i * 7919) % n) as f32, logit);
                row
            })
            .collect();
        of_rows(&rows)
    };
    let ties: Vec<[f32; 11]> = (0..60).map(|i| with(0, 0.3 * noise(5, i))).collect();
    let around: Vec<[f32; 11]> = (0..80)
        .map(|i| {
            let mut row = sized([6, 7, 8].map(|k| -0.5 + noise(k, i)));
            row[..3].copy_from_slice(&[noise(9, i), noise(10, i), 0.6 * noise(11, i)]);
            row
        })
        .collect();
    vec![
        drawn(
            "1000 saturated in a stack",
            "the nearest are drawn, the rest lies behind the stop",
            stack(1000, 1e4),
        ),
        drawn("1000 faint in a stack", "drawn until the stop", stack(1000, -2.0)),
        drawn("60 at one depth", "in the order of the scene", of_rows(&ties)),
        drawn("camera inside of Gaussians", "those between near and far are drawn", of_rows(&around)),
    ]
}

fn places() -> Vec<HardCase> {
    let at = |x: f32, y: f32, z: f32| {
        let mut row = GOOD;
        row[..3].copy_from_slice(&[x, y, z]);
        row
    };
    let behind = [0.2, 0.1, 1e-40, 0.0, -0.0, -1.0, -1e30].map(|z| with(2, z));
    let beside = [at(50.0, 0.0, 2.0), at(0.0, -50.0, 2.0), at(-1e30, 0.0, 2.0), at(0.0, 0.0, 2e10)];
    let depths: Vec<[f32; 11]> = (0..9)
        .map(|i| {
            let z = 10f32.powi(i);
            let mut row = at(0.2 * z * noise(12, i as usize), 0.1 * z, z);
            row[7..10].iter_mut().for_each(|log_scale| *log_scale += z.ln() - 1.0);
            row
        })
        .collect();
    let far_from_the_origin = |offset: DVec3, angles: [f64; 3]| {
        let rotation = DMat3::from_euler(EulerRot::XYZ, angles[0], angles[1], angles[2]);
        let camera = Camera::new(LENS, rotation, -(rotation * offset)).expect("valid");
        let rows: Vec<[f32; 11]> = (0..40)
            .map(|i| {
                let z = 2.0 + 0.1 * f64::from((i * 7) % 40);
                let [x, y] = [13, 14].map(|seed| 0.4 * z * f64::from(noise(seed, i as usize)));
                let mut row = turned([15, 16, 17, 18].map(|seed| noise(seed, i as usize)));
                row[..3].copy_from_slice(&camera.to_world(DVec3::new(x, y, z)).as_vec3().to_array());
                row
            })
            .collect();
        let mut scene = Gaussians::empty(1).expect("degree 1 exists");
        for (i, row) in rows.into_iter().enumerate() {
            let sh: Vec<f32> = (0..12).map(|k| 0.4 * noise(20 + k, i)).collect();
            scene.push(
                [row[0], row[1], row[2]],
                [row[3], row[4], row[5], row[6]],
                [row[7], row[8], row[9]],
                row[10],
                &sh,
            );
        }
        (scene, camera)
    };
    let far = |name: &str, offset: DVec3, angles: [f64; 3]| {
        let (scene, camera) = far_from_the_origin(offset, angles);
        HardCase { camera, ..drawn(name, "drawn", scene) }
    };
    let aside = Intrinsics { cx: -20.0, cy: 30.0, fx: 60.0, fy: 25.0, ..LENS };
    let no_near = Profile { near: 0.0, ..Profile::default() };
    vec![
        background("at, behind and just before the camera", "culled by the near plane", of_rows(&behind)),
        drawn("just beyond the near plane", "drawn, enormous", of_rows(&[with(2, 0.2001), with(2, 0.21)])),
        HardCase {
            profile: no_near,
            ..drawn("near 0, z from 1e-6", "drawn", of_rows(&[at(0.0, 0.0, 1e-6), at(1e-4, 0.0, 1e-3), GOOD]))
        },
        background("beside the picture and beyond far", "culled", of_rows(&beside)),
        drawn(
            "centre beside the picture",
            "the border that reaches in is drawn",
            of_rows(&[at(-1.0, -0.7, 2.0), at(1.4, 0.8, 2.0)]),
        ),
        drawn("z-depths from 1 to 1e8", "drawn in order", of_rows(&depths)),
        background("no Gaussians", "the background", of_rows(&[])),
        far("1e4 units from the origin", DVec3::new(1e4, -8e3, 9e3), [0.0; 3]),
        far("the same, turned", DVec3::new(1e4, -8e3, 9e3), [0.4, -0.7, 2.2]),
        far("1e6 units from the origin, turned", DVec3::new(1e6, -8e5, 9e5), [0.4, -0.7, 2.2]),
        HardCase {
            camera: Camera::new(aside, DMat3::IDENTITY, DVec3::ZERO).expect("valid"),
            ..drawn(
                "principal point outside, fx ≠ fy",
                "drawn",
                of_rows(&[at(1.3, -0.8, 2.0), at(1.0, -1.2, 2.5)]),
            )
        },
    ]
}

/// Pictures that are no multiple of a tile, or numbers of tiles around powers of two.
fn sizes() -> Vec<HardCase> {
    let sizes = [(1, 1), (1, 17), (17, 9), (16, 16), (64, 32), (65, 33), (125, 93)];
    sizes
        .into_iter()
        .map(|(width, height)| {
            let focal = 1.1 * width.max(height) as f64;
            let (cx, cy) = (0.5 * width as f64, 0.5 * height as f64);
            let lens = Intrinsics { fx: focal, fy: focal, cx, cy, width, height };
            let mut scene = Gaussians::empty(0).expect("degree 0 exists");
            for i in 0..30 {
                let z = 2.0 + 0.1 * ((i * 7) % 30) as f32;
                let mean = [0.4 * z * noise(30, i), 0.4 * z * noise(31, i), z];
                let quaternion = [32, 33, 34, 35].map(|seed| noise(seed, i));
                scene.push(mean, quaternion, [-1.5, -2.0, -1.0], noise(36, i), &[0.5, noise(37, i), -0.2]);
            }
            let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::ZERO).expect("valid");
            HardCase { camera, ..drawn(&format!("{width} × {height} px"), "drawn", scene) }
        })
        .collect()
}

/// Golden cases.
fn golden() -> Vec<HardCase> {
    let told = [
        ("e01_aniso1e4", "drawn"),
        ("e02_needle_long", "drawn"),
        ("e03_quat_norms", "drawn"),
        ("e04_near_frustum", "the near plane culls 8 of 23"),
        ("e05_stack300", "drawn until the stop"),
        ("e06_stack300_saturated", "the second one stands on the stop and is not drawn"),
        ("e07_tiny_huge", "drawn; some under 1/255 are not"),
        ("e08_depth_ties", "in the order of the scene"),
        ("e09_far_identity", "drawn"),
        ("e10_far_rotated", "drawn"),
        ("e11_all_culled", "the background"),
        ("e12_column_1x17", "drawn"),
        ("g_antialias", "fainter by the compensation"),
        ("h_gsplat_profile", "alpha is cut at 0.999"),
    ];
    let all = cases();
    told.into_iter()
        .map(|(name, happens)| {
            let (_, case) = all.iter().find(|(other, _)| other == name).expect("a golden case");
            HardCase {
                camera: case.camera,
                profile: case.profile,
                is_drawn: name != "e11_all_culled",
                ambiguous: Some(case.ambiguous.clone()),
                ..drawn(&format!("golden {name}"), happens, case.gaussians.clone())
            }
        })
        .collect()
}

#[test]
fn the_cpu_does_with_each_what_it_should() {
    for case in hard_cases() {
        let complaints = case.complaints(&case.measure(&mut gs_raster::Rasterizer::cpu()));
        assert!(complaints.is_empty(), "{}, {}: {complaints:?}", case.name, case.happens);
    }
}
