use crate::difference::{Difference, difference, ordered_as, turn};
use crate::{Folder, encoded, extension, files, scene};
use gs_scene::{Gaussians, SH_C0, sigmoid};
use proptest::prelude::*;
use splat_formats::{
    Encoder, Error, Format, HalfTurn, Loss, Quantity, Remark, Rule, half_turn, read_scene, write_scene,
};

fn assert_within(found: &Difference, bound: &Difference) -> Result<(), TestCaseError> {
    found.within(bound).map_err(TestCaseError::fail)
}

fn round_trip(scene: &Gaussians, format: Format) -> Gaussians {
    let folder = Folder::new();
    let name = format!("x.{}", format.extension());
    let read = folder.read(&name, &encoded(scene, format)).unwrap();
    assert_eq!((read.format, read.remarks.len()), (format, 0));
    read.gaussians
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn ply_keeps_every_bit(degree in 0usize..4, n in 1usize..200, seed: u64) {
        let scene = scene(degree, n, seed);
        prop_assert_eq!(round_trip(&scene, Format::Ply), scene);
    }

    #[test]
    fn spz_stays_within_its_steps(degree in 0usize..4, n in 1usize..200, seed: u64) {
        let scene = scene(degree, n, seed);
        let bound = Difference {
            // Positions up to 30 leave 18 fractional bits.
            position: 0.5 / 2_f64.powi(18),
            log_scale: 0.5 / 16.0,
            angle: turn(0.5 * std::f64::consts::FRAC_1_SQRT_2 / 511.0),
            opacity: 0.5 / 255.0,
            colour: 0.5 / (0.15 * 255.0) * f64::from(SH_C0),
            sh: 0.5 / 128.0,
        };
        assert_within(&difference(&scene, &round_trip(&scene, Format::Spz)), &bound)?;
    }

    #[test]
    fn splat_stays_within_its_steps(degree in 0usize..4, n in 1usize..200, seed: u64) {
        let scene = scene(degree, n, seed);
        let bound = Difference {
            // A byte holds up to 127 / 128, so an end is off by a whole step; all four are stored and then normalised.
            angle: 4.0 * (0.5 * 2.0 * (1.0_f64 / 128.0)).asin(),
            opacity: 0.5 / 255.0,
            colour: 0.5 / 255.0,
            ..Difference::default()
        };
        let read = round_trip(&scene, Format::Splat);
        prop_assert_eq!(read.sh_degree(), 0);
        assert_within(&difference(&scene, &read), &bound)?;
    }

    #[test]
    fn gltf_keeps_all_but_the_last_bits(degree in 0usize..4, n in 1usize..200, seed: u64) {
        let scene = scene(degree, n, seed);
        let read = round_trip(&scene, Format::Glb);
        prop_assert_eq!(read.sh(), scene.sh());
        assert_within(&difference(&scene, &read), &Difference::default())?;
    }

    #[test]
    fn compressed_ply_stays_within_its_steps(degree in 0usize..4, n in 1usize..200, seed: u64) {
        let scene = scene(degree, n, seed);
        let read = round_trip(&scene, Format::CompressedPly);
        // Chunks span at most -30 to 30, and -8 to 4 for log-scales.
        let bound = Difference {
            position: 0.5 * 60.0 / 1023.0,
            log_scale: 0.5 * 12.0 / 1023.0,
            angle: turn(0.5 * std::f64::consts::SQRT_2 / 1023.0),
            opacity: 0.5 / 255.0,
            colour: 0.5 / 255.0,
            // A quarter of the range of -4 to 4 is never at its ends.
            sh: 0.5 / 32.0,
        };
        // Where two Gaussians are closer than the steps, the nearest need not be the right one.
        let apart = |a: &[f32], b: &[f32]| (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f32::max);
        let rows: Vec<&[f32]> = scene.geometry().chunks_exact(11).collect();
        prop_assume!((0..n).all(|i| (0..i).all(|j| apart(rows[i], rows[j]) > 0.12)));
        assert_within(&difference(&ordered_as(&scene, &read), &read), &bound)?;
    }

    #[test]
    fn packed_numbers_are_packed_to_the_same_again(degree in 0usize..4, n in 1usize..100, seed: u64) {
        let scene = scene(degree, n, seed);
        // Rotations are normalised in between, which may move them to the next step.
        let without_rotations = |mut scene: Gaussians| {
            scene.buffers_mut().0.chunks_exact_mut(11).for_each(|row| row[3..7].fill(0.0));
            scene
        };
        for format in [Format::Spz, Format::Splat] {
            let once = round_trip(&scene, format);
            let twice = without_rotations(round_trip(&once, format));
            prop_assert!(twice == without_rotations(once), "{}", format);
        }
    }
}

#[test]
fn ends_of_ranges_are_kept_or_told() {
    let mut scene = Gaussians::empty(1).unwrap();
    let sh = [9.0, 0.0, -9.0, 5.0, 0.0, -5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    let (inf, quaternion) = (f32::INFINITY, [0.0, 0.0, -2.0, 0.0]);
    scene.push([0.0; 3], quaternion, [-inf, 0.0, 30.0], inf, &sh);
    scene.push([1e4, 0.0, -1e4], quaternion, [-5.0; 3], -inf, &[0.0; 12]);
    for format in [Format::CompressedPly, Format::Spz, Format::Splat, Format::Glb] {
        let encoder = Encoder::new(&scene, format).unwrap();
        let clipped: Vec<Quantity> = encoder
            .losses()
            .iter()
            .filter_map(|loss| match loss {
                Loss::Clipped { quantity, gaussians: 1, of: 2, .. } => Some(*quantity),
                Loss::Saturated { quantity, gaussians: 2, of: 2 } => Some(*quantity),
                _ => None,
            })
            .collect();
        let expected: &[Quantity] = match format {
            Format::CompressedPly => &[Quantity::Size, Quantity::Sh],
            Format::Spz => &[Quantity::Size, Quantity::Colour, Quantity::Sh],
            Format::Splat => &[Quantity::Colour],
            _ => &[Quantity::Opacity],
        };
        assert_eq!(clipped, expected, "{format}");
        assert!(encoder.losses().iter().all(|loss| !loss.to_string().is_empty()));
        let has = |wanted: fn(&Loss) -> bool| encoder.losses().iter().any(wanted);
        assert_eq!(has(|loss| matches!(loss, Loss::ShDropped { degree: 1 })), format == Format::Splat);
        assert_eq!(has(|loss| matches!(loss, Loss::Order)), format == Format::CompressedPly);
        let read = round_trip(&scene, format);
        assert!(read.geometry().iter().chain(read.sh()).all(|value| value.is_finite()), "{format}");
        let opacity = |i: usize| sigmoid(read.geometry()[11 * i + 10]);
        assert!(opacity(0).max(opacity(1)) > 0.998 && opacity(0).min(opacity(1)) < 0.002, "{format}");
    }
    assert_eq!(Encoder::new(&scene, Format::Ply).unwrap().losses(), []);
    assert_eq!(round_trip(&scene, Format::Ply), scene);
}

#[test]
fn a_scene_that_a_format_cannot_hold_is_refused_with_the_gaussian() {
    let value = |change: fn(&mut [f32], &mut [f32])| {
        let mut scene = scene(1, 5, 1);
        let (geometry, sh) = scene.buffers_mut();
        change(&mut geometry[22..33], &mut sh[24..36]);
        scene
    };
    let cases: [(Gaussians, Quantity); 7] = [
        (value(|g, _| g[1] = f32::NAN), Quantity::Position),
        (value(|g, _| g[2] = f32::INFINITY), Quantity::Position),
        (value(|g, _| g[3..7].fill(0.0)), Quantity::Rotation),
        (value(|g, _| g[8] = 89.0), Quantity::Size),
        (value(|g, _| g[10] = f32::NAN), Quantity::Opacity),
        (value(|_, sh| sh[1] = f32::NAN), Quantity::Colour),
        (value(|_, sh| sh[5] = f32::INFINITY), Quantity::Sh),
    ];
    for (scene, expected) in cases {
        for format in Format::ALL.into_iter().filter(|&format| format != Format::Ply) {
            match Encoder::new(&scene, format) {
                Err(Error::Unfit { rule: Rule::Value { gaussian: 2, quantity, .. }, .. }) => {
                    assert_eq!(quantity, expected, "{format}");
                }
                other => panic!("{format}: {other:?}"),
            }
        }
        assert!(Encoder::new(&scene, Format::Ply).is_ok());
    }
    let empty = Gaussians::empty(0).unwrap();
    assert!(matches!(Encoder::new(&empty, Format::Spz), Err(Error::Unfit { rule: Rule::Empty, .. })));
    let mut far = Gaussians::empty(0).unwrap();
    far.push([0.0, 9e6, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0; 3], 0.0, &[0.0; 3]);
    assert!(
        Encoder::new(&far, Format::Spz).unwrap_err().to_string().contains("Gaussian 0: position is 9000000")
    );
}

#[test]
fn the_name_chooses_what_is_written_and_the_content_what_is_read() {
    let folder = Folder::new();
    let scene = scene(1, 20, 7);
    for (format, name, bytes) in files(&scene) {
        let path = folder.path(&name);
        write_scene(&path, &scene).unwrap();
        assert!(std::fs::read(&path).unwrap() == bytes, "{name}");
        assert_eq!(extension(&name), Some(format));
        // The name of another format does not mislead.
        for other in ["y.ply", "y.glb", "y.spz", "y"] {
            if format != Format::Splat {
                assert_eq!(folder.read(other, &bytes).unwrap().format, format, "{name} as {other}");
            }
        }
        assert_eq!(folder.read("y.splat", &bytes).unwrap().format, format, "{name} as .splat");
    }
    for name in ["scene", "scene.obj", "scene.gltf"] {
        let error = write_scene(&folder.path(name), &scene).unwrap_err();
        assert!(matches!(error, Error::Extension { .. }) && !folder.path(name).exists());
    }
    assert!(matches!(read_scene(&folder.path("absent.spz")), Err(Error::Scene(_))));
    assert!(matches!(folder.read("y.obj", b"v 1 2 3"), Err(Error::Unknown { .. })));
}

#[test]
fn an_empty_ply_is_a_scene() {
    let empty = Gaussians::empty(2).unwrap();
    assert_eq!(round_trip(&empty, Format::Ply), empty);
}

#[test]
fn a_failed_write_leaves_the_old_file() {
    let folder = Folder::new();
    let path = folder.path("x.spz");
    write_scene(&path, &scene(0, 2, 3)).unwrap();
    let before = std::fs::read(&path).unwrap();
    let mut broken = scene(0, 2, 3);
    broken.buffers_mut().0[0] = f32::NAN;
    assert!(write_scene(&path, &broken).is_err());
    assert!(std::fs::read(&path).unwrap() == before);
}

#[test]
fn comments_and_columns_that_are_not_read_are_told() {
    let folder = Folder::new();
    let bytes = encoded(&scene(0, 3, 1), Format::Ply);
    let text = String::from_utf8_lossy(&bytes[..200]).into_owned();
    assert!(text.contains("comment SplatRenderMode: default"));
    let at = text.find("default").unwrap();
    let mip = [&bytes[..at], b"mip", &bytes[at + 7..]].concat();
    assert_eq!(folder.read("x.ply", &mip).unwrap().remarks, [Remark::Antialiased]);
    let end = bytes.windows(10).position(|window| window == b"end_header").unwrap();
    let more = String::from_utf8_lossy(&bytes[..end]).replace(" nz\n", " label\n").into_bytes();
    let more = [&more, &b"element camera 0\nproperty float fov\n"[..], &bytes[end..]].concat();
    let names = ["label", "element camera"].map(str::to_owned).to_vec();
    assert_eq!(folder.read("x.ply", &more).unwrap().remarks, [Remark::Unread { names }]);
}

#[test]
fn a_half_turn_goes_through_every_format() {
    let plain = scene(3, 10, 5);
    let mut turned = plain.clone();
    half_turn(&mut turned, HalfTurn::X);
    for format in [Format::Spz, Format::Glb] {
        let mut read = round_trip(&turned, format);
        half_turn(&mut read, HalfTurn::X);
        let apart = difference(&plain, &read);
        assert!(apart.position < 1e-4 && apart.angle < 0.01 && apart.sh < 0.01, "{format} {apart:?}");
    }
}
