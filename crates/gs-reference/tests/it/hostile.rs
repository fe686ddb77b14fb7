//! Input that breaks renderers: gradients are finite, and exactly 0 of what is not drawn.

use glam::{DMat3, DVec3};
use gs_reference::{PixelGradients, Profile, ReferenceGradients, Variable, backward, project};
use gs_scene::{Camera, Gaussians, Intrinsics};
use proptest::prelude::*;

const LENS: Intrinsics = Intrinsics { fx: 6.0, fy: 5.0, cx: 3.0, cy: 1.5, width: 5, height: 4 };

/// Mean, quaternion, log scale and logit of a Gaussian that is drawn.
const GOOD: [f32; 11] = [0.1, 0.1, 2.0, 1.0, 0.2, 0.1, 0.3, -1.5, -1.0, -2.0, 1.0];

fn gradients(gaussians: &Gaussians, profile: &Profile) -> ReferenceGradients {
    let camera = Camera::new(LENS, DMat3::IDENTITY, DVec3::ZERO).expect("a camera");
    let weights = PixelGradients { image: vec![1.0; 60], alpha: vec![-0.5; 20], depth_sum: vec![0.25; 20] };
    let found = backward(gaussians, &camera, [0.1, 0.2, 0.3], profile, &weights);
    for variable in Variable::ALL {
        assert!(found.by(variable).iter().all(|by| by.is_finite()), "{variable:?}: {found:?}");
    }
    found
}

fn all_zero(values: &[f64]) -> bool {
    values.iter().all(|&value| value == 0.0)
}

#[test]
fn what_is_not_drawn_has_no_gradient() {
    let sh = [0.5, 0.1, -0.2];
    let with = |columns: &[(usize, f32)]| {
        let mut row = GOOD;
        columns.iter().for_each(|&(column, value)| row[column] = value);
        row
    };
    let culled = [
        with(&[(2, -2.0)]),
        with(&[(2, 0.1)]),
        with(&[(2, 1e20)]),
        with(&[(0, f32::NAN)]),
        with(&[(3, 0.0), (4, 0.0), (5, 0.0), (6, 0.0)]),
        with(&[(7, 1e4)]),
        with(&[(10, f32::NEG_INFINITY)]),
        with(&[(10, -20.0)]),
        with(&[(0, 1e6)]),
    ];
    for antialias in [false, true] {
        let profile = Profile { antialias, ..Profile::default() };
        let alone = gradients(&Gaussians::new(0, GOOD.to_vec(), sh.to_vec()).unwrap(), &profile);
        assert!(Variable::ALL.iter().all(|&variable| !all_zero(&alone.by(variable))));
        for row in culled {
            let both = Gaussians::new(0, [row, GOOD].concat(), [sh, sh].concat()).unwrap();
            let found = gradients(&both, &profile);
            assert!(all_zero(&found.geometry[..11]) && all_zero(&found.sh[..3]), "{row:?}");
            assert_eq!((&found.geometry[11..], &found.sh[3..]), (&alone.geometry[..], &alone.sh[..]));
            assert_eq!((found.world_to_camera, found.twist), (alone.world_to_camera, alone.twist));
        }
    }
}

#[test]
fn nothing_to_draw_leaves_the_background() {
    let found = gradients(&Gaussians::empty(3).unwrap(), &Profile::default());
    assert_eq!(found.background, [20.0; 3]);
    assert!(all_zero(&found.world_to_camera) && found.geometry.is_empty() && found.sh.is_empty());
}

/// Numbers of every size, and some that are none.
fn any_number() -> impl Strategy<Value = f32> {
    let special =
        [0.0, -0.0, 1e-45, -1e-38, 1e-19, 1e-6, 1e6, -1e19, 3e38, 88.7, -88.0, f32::NAN, f32::INFINITY];
    prop_oneof![4 => -2.0..2.0f32, 1 => prop::sample::select(special.to_vec())]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn gradients_are_finite(
        rows in prop::collection::vec(prop::array::uniform11(any_number()), 1..4),
        sh in prop::collection::vec(any_number(), 3 * 4 * 3),
        antialias: bool,
    ) {
        let n = rows.len();
        let mut geometry = rows.concat();
        // Most of them in front of the camera.
        geometry.chunks_exact_mut(11).for_each(|row| row[2] = row[2].abs() + 0.25);
        let gaussians = Gaussians::new(1, geometry, sh[..n * 12].to_vec()).expect("valid");
        gradients(&gaussians, &Profile { antialias, ..Profile::default() });
    }
}

#[test]
fn a_gaussian_at_the_centre_of_the_camera_is_left_out() {
    // It has no direction. A near plane behind the camera lets it come so far.
    let camera = Camera::new(LENS, DMat3::IDENTITY, DVec3::ZERO).unwrap();
    let gaussians = Gaussians::new(0, [&[0.0; 3], &GOOD[3..]].concat(), vec![0.5; 3]).unwrap();
    let profile = Profile { near: -1.0, ..Profile::default() };
    assert!(project(&gaussians, 0, &camera, &profile).is_none());
}
