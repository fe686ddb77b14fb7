//! A splat as one tile sees it, and where in the tile it may be seen.

use super::TILE;
use super::math::{ROUND, exp2};
use super::project::{BATCH, Splat, Splats};
use super::tile::{Place, SIDE, Strips, centres};
use crate::RenderSettings;
use cpu_kernels::pulp::{Simd, cast};
use cpu_kernels::vector::abs;

/// Thresholds of the blending.
#[derive(Clone, Copy)]
pub(super) struct Limits {
    pub(super) log2_alpha_min: f32,
    pub(super) alpha_max: f32,
    pub(super) transmittance_min: f32,
}

impl Limits {
    pub(super) fn new(settings: &RenderSettings) -> Self {
        Self {
            log2_alpha_min: settings.alpha_min.log2(),
            alpha_max: settings.alpha_max,
            transmittance_min: settings.transmittance_min,
        }
    }
}

/// A splat as one tile sees it, pixels from the tile's top-left corner: there, f32 keeps the position to a millionth of a
/// pixel in images of any size. The pass backward takes the same numbers and decisions from here.
#[derive(Clone, Copy)]
pub(super) struct Local {
    x: f32,
    y: f32,
    falloff: [f32; 2],
    shear: f32,
    log2_opacity: f32,
    /// Half width of the ellipse, pixels.
    half_width: f32,
    pub(super) rgb: [f32; 3],
    pub(super) depth: f32,
}

/// Splats that follow each other in a tile's list. Each step is done for all of them before the next: the waits for memory overlap, and those for
/// results.
#[repr(align(64))]
pub(super) struct Batch {
    fetched: [Splat; BATCH],
    splats: [Local; BATCH],
    len: usize,
}

impl Batch {
    pub(super) const EMPTY: Self =
        Self { fetched: [Splat::NONE; BATCH], splats: [Local::NONE; BATCH], len: 0 };

    /// Takes the next splats.
    #[inline(always)]
    pub(super) fn fetch<'a>(
        &mut self,
        splats: &Splats,
        next: impl Iterator<Item = &'a u32>,
        origin: [u32; 2],
    ) {
        let mut indices = [0; BATCH];
        self.len = 0;
        for (index, &next) in indices.iter_mut().zip(next) {
            *index = next;
            self.len += 1;
        }
        let fetched = splats.fetch(&indices[..self.len], &mut self.fetched);
        for (local, splat) in self.splats.iter_mut().zip(fetched) {
            *local = Local::new(splat, origin);
        }
    }

    #[inline(always)]
    pub(super) fn splats(&self) -> &[Local] {
        &self.splats[..self.len]
    }

    /// The strips in which each may be seen.
    #[inline(always)]
    pub(super) fn strips<S: Simd>(&self, simd: S, limits: Limits) -> [Strips; BATCH] {
        let mut strips = [Strips::NONE; BATCH];
        for (strips, splat) in strips.iter_mut().zip(self.splats()) {
            *strips = splat.strips(simd, limits);
        }
        strips
    }
}

/// A splat in a vector of pixels.
#[derive(Clone, Copy)]
pub(super) struct Touch<S: Simd> {
    /// Distance from the middle of the ellipse's row, pixels.
    pub(super) dx: S::f32s,
    /// The opacity; some number where it is below `alpha_min`.
    pub(super) alpha: S::f32s,
    /// Where it is at least `alpha_min`.
    pub(super) is_seen: S::m32s,
}

impl Local {
    const NONE: Self = Self {
        x: 0.0,
        y: 0.0,
        falloff: [0.0; 2],
        shear: 0.0,
        log2_opacity: 0.0,
        half_width: 0.0,
        rgb: [0.0; 3],
        depth: 0.0,
    };

    #[inline(always)]
    fn new(splat: &Splat, origin: [u32; 2]) -> Self {
        Self {
            x: (splat.mean[0] - f64::from(origin[0])) as f32,
            y: (splat.mean[1] - f64::from(origin[1])) as f32,
            falloff: splat.falloff,
            shear: splat.shear,
            log2_opacity: splat.log2_opacity,
            half_width: splat.half_width,
            rgb: splat.rgb,
            depth: splat.depth,
        }
    }

    /// The strips in which the splat may be seen: those that the rows of its ellipse reach, and now and then one more. They are found without
    /// branches and before any is blended: no processor foresees which pixels a splat covers, and where it guesses wrong it begins anew.
    #[inline(always)]
    fn strips<S: Simd>(&self, simd: S, limits: Limits) -> Strips {
        // More than rounding takes from a logarithm (of numbers below 2⁸), and from a position (as a part of the largest number on the way).
        const MARGIN: f32 = 1e-4;
        const ROUNDING: f32 = 2e-6;
        // Added before numbers are rounded to the nearest: what is hardly above a whole number is rounded down, all else up.
        const UP: f32 = 0.49;
        const COLUMNS: f32 = SIDE as f32;
        let number = |v: f32| simd.splat_f32s(v);
        let (zero, per_strip) = (number(0.0), number(COLUMNS.recip()));
        let level = number(self.log2_opacity - limits.log2_alpha_min + MARGIN);
        // Of a strip's rows the one nearest the centre of the ellipse has the widest part of it, whose middle may lie beside those of the others.
        let beside = 0.5 * (Strips::rows::<S>() as f32 - 1.0);
        let slack = number(ROUNDING * (self.x.abs() + self.half_width) + self.shear.abs() * beside);
        let mut found = Rows([0; TILE]);
        let rows = TILE / Strips::rows::<S>();
        let vectors = S::as_mut_simd_u32s(&mut found.0).0.iter_mut();
        for (strips, &middle) in vectors.zip(Rows::middles::<S>()).take(rows.div_ceil(S::F32_LANES)) {
            let dy = simd.sub_f32s(middle, number(self.y));
            let nearest = simd.max_f32s(simd.sub_f32s(abs(simd, dy), number(beside)), zero);
            let level = simd.mul_add_e_f32s(simd.mul_f32s(number(self.falloff[1]), nearest), nearest, level);
            // Half a row of the ellipse: the root of level / -falloff.
            let square = simd.mul_f32s(simd.max_f32s(level, zero), number(-self.falloff[0].recip()));
            let half = simd.add_f32s(simd.sqrt_f32s(square), slack);
            let middle = simd.mul_add_e_f32s(number(self.shear), dy, number(self.x));
            let left = simd.mul_f32s(simd.sub_f32s(middle, half), per_strip);
            let right = simd.mul_f32s(simd.add_f32s(middle, half), per_strip);
            // How many strips end left of it: the last pixel of strip k is at k + (COLUMNS - ½) / COLUMNS. And how many begin right of it.
            let before = simd.add_f32s(left, number(UP - (COLUMNS - 0.5) / COLUMNS));
            let after = simd.sub_f32s(number(COLUMNS - 1.0 + UP + 0.5 / COLUMNS), right);
            let count = |strips: S::f32s| {
                let strips = simd.min_f32s(simd.max_f32s(strips, zero), number(COLUMNS));
                cast(simd.add_f32s(strips, number(ROUND)))
            };
            let all = simd.splat_u32s((1 << SIDE) - 1);
            let row = simd.and_u32s(
                simd.wrapping_dyn_shl_u32s(all, count(before)),
                simd.wrapping_dyn_shr_u32s(all, count(after)),
            );
            *strips = simd.select_u32s(simd.greater_than_f32s(level, zero), row, simd.splat_u32s(0));
        }
        Strips::of_rows(&found.0[..rows])
    }

    /// Distance from the centre of the ellipse down, pixels.
    #[inline(always)]
    pub(super) fn dy<S: Simd>(&self, simd: S, place: Place) -> S::f32s {
        let [_, down] = centres::<S>(place);
        simd.sub_f32s(down, simd.splat_f32s(self.y))
    }

    #[inline(always)]
    pub(super) fn touch<S: Simd>(&self, simd: S, place: Place, limits: Limits) -> Touch<S> {
        let number = |v: f32| simd.splat_f32s(v);
        let dy = self.dy(simd, place);
        let falloff = simd.mul_f32s(simd.mul_f32s(number(self.falloff[1]), dy), dy);
        let middle = simd.add_f32s(number(self.x), simd.mul_f32s(number(self.shear), dy));
        let [across, _] = centres::<S>(place);
        let dx = simd.sub_f32s(across, middle);
        let log2_alpha = simd.mul_add_e_f32s(
            simd.mul_f32s(number(self.falloff[0]), dx),
            dx,
            simd.add_f32s(falloff, number(self.log2_opacity)),
        );
        let is_seen = simd.greater_than_or_equal_f32s(log2_alpha, number(limits.log2_alpha_min));
        Touch { dx, alpha: exp2(simd, log2_alpha), is_seen }
    }
}

/// A number per row of strips; of the rows of a tile, if a strip is one row high.
#[repr(align(64))]
struct Rows<T>([T; TILE]);

impl Rows<f32> {
    /// The middles of rows of strips, pixels from the tile's top; behind the last, some number.
    #[inline(always)]
    fn middles<S: Simd>() -> &'static [S::f32s] {
        static MIDDLES: [Rows<f32>; 3] = [Rows::apart(1), Rows::apart(2), Rows::apart(4)];
        S::as_simd_f32s(&MIDDLES[Strips::rows::<S>().ilog2() as usize].0).0
    }

    const fn apart(pixels: usize) -> Self {
        let mut middles = [0.0; TILE];
        let mut row = 0;
        while row < TILE {
            middles[row] = (row as f32 + 0.5) * pixels as f32;
            row += 1;
        }
        Self(middles)
    }
}

#[cfg(test)]
mod tests {
    use super::{Limits, Local};
    use crate::RenderSettings;
    use crate::cpu::tile::{LANES, PATCHES, Place};
    use cpu_kernels::pulp::{Scalar, Simd};
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    /// The vectors in whose pixels a splat is seen, and those of the strips that are found for it.
    fn seen_and_found<S: Simd>(simd: S, splat: &Local) -> [BTreeSet<Place>; 2] {
        simd.vectorize(
            #[inline(always)]
            || {
                let limits = Limits::new(&RenderSettings::default());
                let places =
                    (0..PATCHES).flat_map(|patch| (0..LANES / S::F32_LANES).map(move |v| (patch, v)));
                let is_seen = |&place: &Place| {
                    simd.first_true_m32s(splat.touch(simd, place, limits).is_seen) < S::F32_LANES
                };
                let mut found = BTreeSet::new();
                splat.strips(simd, limits).for_each::<S>(|_, place| {
                    assert!(found.insert(place), "visited twice");
                });
                [places.filter(is_seen).collect(), found]
            },
        )
    }

    /// Of vectors of each length; those of AVX-512 are here pairs of AVX2's.
    fn each_length(splat: &Local) -> Vec<[BTreeSet<Place>; 2]> {
        let mut found = vec![seen_and_found(Scalar, splat)];
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = cpu_kernels::pulp::x86::V3::try_new() {
            use cpu_kernels::pulp::x86::{V3_128b, V3_512b};
            found.push(seen_and_found(V3_128b(avx2), splat));
            found.push(seen_and_found(avx2, splat));
            found.push(seen_and_found(V3_512b(avx2), splat));
        }
        found
    }

    fn ellipse(centre: [f32; 2], deviations: [f32; 2], shear: f32, log2_opacity: f32) -> Local {
        let falloff = deviations.map(|deviation| -0.5 * std::f32::consts::LOG2_E / (deviation * deviation));
        let level = log2_opacity + 8.0;
        // The row through the centre, and how far the others lie beside it.
        let [along, down] = falloff.map(|falloff| (level / -falloff).max(0.0).sqrt());
        Local {
            x: centre[0],
            y: centre[1],
            falloff,
            shear,
            log2_opacity,
            half_width: along.hypot(shear * down),
            ..Local::NONE
        }
    }

    proptest! {
        #[test]
        fn where_a_splat_is_seen_is_found(
            x in prop_oneof![-20.0..36.0_f32, -3e3..3e3_f32, -1e6..1e6_f32],
            y in prop_oneof![-20.0..36.0_f32, -3e3..3e3_f32],
            across in prop_oneof![0.3..8.0_f32, 0.05..1e5_f32],
            down in prop_oneof![0.3..8.0_f32, 0.05..1e5_f32],
            shear in prop_oneof![-2.0..2.0_f32, -300.0..300.0_f32],
            log2_opacity in -8.5..0.0_f32,
        ) {
            let centred = ellipse([x, y], [across, down], shear, log2_opacity);
            // The same with a row through the tile, wherever its centre is.
            let through = ellipse([x - shear * (8.0 - y), y], [across, down], shear, log2_opacity);
            for splat in [centred, through] {
                for [seen, found] in each_length(&splat) {
                    prop_assert!(seen.is_subset(&found), "{:?}", seen.difference(&found));
                }
            }
        }
    }

    #[test]
    fn hardly_more_is_found() {
        let mut state = 1_u32;
        let mut uniform = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let mut sums = Vec::new();
        for _ in 0..2000 {
            let centre = [0, 1].map(|_| uniform() * 32.0 - 8.0);
            let deviations = [0, 1].map(|_| 0.6 + 3.0 * uniform());
            let splat = ellipse(centre, deviations, uniform() - 0.5, -4.0 * uniform());
            let found = each_length(&splat);
            sums.resize(found.len(), [0, 0]);
            for (sums, found) in sums.iter_mut().zip(found) {
                for (sum, found) in sums.iter_mut().zip(found) {
                    *sum += found.len();
                }
            }
        }
        // A strip has four of the vectors of scalar code, of which not all need be seen.
        let shares = [1.4, 1.1, 1.1, 1.1];
        for ([seen, found], share) in sums.into_iter().zip(shares) {
            assert!((found as f64) < share * seen as f64, "{found} vectors for {seen}");
        }
    }
}
