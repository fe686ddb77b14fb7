//! Footprints, and the fronts of ellipsoids.

use super::{Chain, UNTOUCHED, close, exact, groups, of, one, words};
use crate::check::Row;
use gs_raster::gpu::{Gpu, PassBuffer};
use gs_reference::Deviation;
use gs_reference::project::Footprints;
use gs_reference::tolerance::{PASS_NUMBER, PASS_POSITION};
use gs_shaders::{CULLED, GEOMETRY, N_COUNTERS, PROJECT, Splat, Surface};
use std::f64::consts::LN_2;

pub(super) fn rows(gpu: &mut Gpu, input: &Chain, truth: &Chain) -> Vec<Row> {
    let n = input.n_gaussians() as usize;
    let nothing = vec![UNTOUCHED; n];
    let no_splats = vec![[UNTOUCHED; size_of::<Splat>() / 4]; n];
    let no_surfaces = vec![[UNTOUCHED; size_of::<Surface>() / 4]; n];
    let mut run = |entry_point: &str, surfaces: PassBuffer| {
        let buffers = [
            one(&input.view.frame),
            of(&input.view.geometry),
            of(&input.view.sh),
            of(&no_splats),
            of(&nothing),
            of(&nothing),
            of(&[0u32; N_COUNTERS]),
            surfaces,
        ];
        gpu.run_pass(&PROJECT, entry_point, input.view.features, groups(n), &buffers).expect("the pass runs")
    };
    let out = run("project", PassBuffer::Unused);
    let mut rows = footprints("project", &truth.lists.footprints, &out);
    let out = run("project_ellipsoids", of(&no_surfaces));
    let expected = &truth.ellipsoids;
    rows.extend(footprints("project_ellipsoids", &expected.lists.footprints, &out));
    rows.extend(fronts(&expected.lists.footprints, &expected.surfaces, &words(&out[7])));
    rows
}

fn footprints(of: &str, expected: &Footprints, out: &[Vec<u8>]) -> Vec<Row> {
    let (splats, keys): (Vec<Splat>, Vec<u32>) = (words(&out[3]), words(&out[4]));
    let visible: Vec<bool> = expected.depth_keys.iter().map(|&key| key != CULLED).collect();
    let culled = splats.iter().zip(&visible).filter(|(_, visible)| !**visible);
    let untouched: Vec<u32> = culled.flat_map(|(splat, _)| words::<u32>(bytemuck::bytes_of(splat))).collect();
    let mut rows: Vec<Row> = [
        exact(&format!("{of}: counters"), &expected.counters, &words(&out[6])),
        exact(&format!("{of}: order"), &expected.order, &words(&out[5])),
        exact(&format!("{of}: depth_keys"), &expected.depth_keys, &keys),
        exact(&format!("{of}: splats not visible"), &vec![UNTOUCHED; untouched.len()], &untouched),
    ]
    .into_iter()
    .flatten()
    .collect();

    let pairs = || expected.splats.iter().zip(&splats).zip(&visible).filter(|(_, visible)| **visible);
    let each = |value: &dyn Fn(&Splat) -> f64| -> [Vec<f64>; 2] {
        pairs().map(|((expected, found), _)| (value(expected), value(found))).unzip().into()
    };
    // Every number by itself.
    let relative = |output: &str, value: &dyn Fn(&Splat) -> f64, bound: f64| {
        let [expected, found] = each(value);
        let ratios: Vec<f64> =
            found.iter().zip(&expected).map(|(found, expected)| found / expected).collect();
        close(&format!("{of}: {output}"), &vec![1.0; expected.len()], &ratios, &[], |_| bound)
    };
    let absolute = |output: &str, value: &dyn Fn(&Splat) -> f64, bound: f64| {
        let [expected, found] = each(value);
        close(&format!("{of}: {output}"), &expected, &found, &[], |deviation| {
            bound * deviation.largest.max(1.0)
        })
    };
    let joined = |high: f32, low: f32| f64::from(high) + f64::from(low);
    rows.extend(
        [
            absolute("mean.x", &|splat| joined(splat.mean[0], splat.mean_low[0]), PASS_POSITION),
            absolute("mean.y", &|splat| joined(splat.mean[1], splat.mean_low[1]), PASS_POSITION),
            relative("falloff.x", &|splat| splat.falloff[0].into(), PASS_NUMBER),
            relative("falloff.y", &|splat| splat.falloff[1].into(), PASS_NUMBER),
            absolute("shear", &|splat| joined(splat.shear, splat.shear_low), PASS_NUMBER),
            absolute("log2_opacity", &|splat| splat.log2_opacity.into(), PASS_NUMBER),
            absolute("red", &|splat| splat.rgb[0].into(), PASS_NUMBER),
            absolute("green", &|splat| splat.rgb[1].into(), PASS_NUMBER),
            absolute("blue", &|splat| splat.rgb[2].into(), PASS_NUMBER),
            relative("depth", &|splat| splat.depth.into(), PASS_NUMBER),
        ]
        .into_iter()
        .flatten(),
    );
    rows
}

fn fronts(footprints: &Footprints, expected: &[Surface], found: &[Surface]) -> Vec<Row> {
    let visible: Vec<bool> = footprints.depth_keys.iter().map(|&key| key != CULLED).collect();
    let culled = found.iter().zip(&visible).filter(|(_, visible)| !**visible);
    let untouched: Vec<u32> =
        culled.flat_map(|(surface, _)| words::<u32>(bytemuck::bytes_of(surface))).collect();
    let each = |surfaces: &[Surface], value: fn(&Surface) -> f32| -> Vec<f64> {
        let pairs = surfaces.iter().zip(&visible).filter(|(_, visible)| **visible);
        pairs.map(|(surface, _)| value(surface).into()).collect()
    };
    let slopes = |output: &str, value: fn(&Surface) -> f32| {
        let bound = |deviation: &Deviation| PASS_NUMBER * deviation.largest;
        close(&format!("surfaces: {output}"), &each(expected, value), &each(found, value), &[], bound)
    };
    // Those along the rays, relative to those along z, of which the slopes are the rest.
    let along_z: Vec<f64> = expected
        .iter()
        .zip(&footprints.splats)
        .zip(&visible)
        .filter(|(_, visible)| **visible)
        .map(|((surface, splat), _)| {
            let [by_e, by_y] = [(surface.slope_e, splat.falloff[0]), (surface.slope_y, splat.falloff[1])]
                .map(|(slope, falloff)| f64::from(slope).powi(2) / (-2.0 * LN_2 * f64::from(falloff)));
            (f64::from(surface.sigma_z).powi(2) + by_e + by_y).sqrt()
        })
        .collect();
    let share = |surfaces: &[Surface]| -> Vec<f64> {
        each(surfaces, |surface| surface.sigma_z)
            .iter()
            .zip(&along_z)
            .map(|(sigma, whole)| sigma / whole)
            .collect()
    };
    [
        exact("surfaces not visible", &vec![UNTOUCHED; untouched.len()], &untouched),
        slopes("slope_e", |surface| surface.slope_e),
        slopes("slope_y", |surface| surface.slope_y),
        close("surfaces: sigma_z", &share(expected), &share(found), &[], |_| PASS_NUMBER),
    ]
    .into_iter()
    .flatten()
    .collect()
}

pub(super) fn perturb(chain: &mut Chain) {
    let nearest = chain.lists.order[0] as usize;
    chain.view.geometry[nearest * GEOMETRY] += 1e-5;
}
