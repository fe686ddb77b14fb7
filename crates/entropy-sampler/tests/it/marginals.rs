use entropy_sampler::{Budget, ImportanceMap, Sampler, sample, solve};
use rayon::prelude::*;

const DRAWS: u64 = 10_000;

/// Views that show what may go wrong: saturated and flat parts, weights, and pixels that all have the same threshold
/// because their distances are multiples of 64. P of none is so small that the binomial distribution is not normal.
fn views() -> Vec<ImportanceMap> {
    let ramp = |i: usize| if i.is_multiple_of(9) { 1.0 } else { 0.04 + 0.3 * (i % 61) as f32 / 60.0 };
    let shaded = ImportanceMap::new(61, 70, (0..61 * 70).map(ramp).collect());
    let stripes = ImportanceMap::new(40, 20, (0..800).map(|i| f32::from(u8::from(i % 40 < 9))).collect());
    let weighted = ImportanceMap::uniform(35, 20)
        .and_then(|map| map.with_weights((0..700).map(|i| 0.05 + 0.95 * (i % 36) as f32 / 35.0).collect()));
    let corner = |i: usize| (i % 65).is_multiple_of(64) && (i / 65).is_multiple_of(64);
    let apart = (0..65 * 65).map(|i| if corner(i) { 0.2 + i as f32 / 10_000.0 } else { 0.0 });
    let apart = ImportanceMap::new(65, 65, apart.collect());
    [shaded, stripes, weighted, apart].map(|map| map.expect("in 0..1")).into()
}

/// Over 10,000 draws, the share of pixels that were chosen more or less often than P says by more than 4 standard
/// errors; for independent draws of the normal distribution it would be 6e-5.
fn share_beyond_4_errors(maps: &[ImportanceMap], count: usize, sampler: Sampler) -> (usize, usize) {
    let pixels: usize = maps.iter().map(|map| map.values().len()).sum();
    let draw = |seeds: std::ops::Range<u64>| {
        let mut hits = vec![0u32; pixels];
        for seed in seeds {
            let samples = sample(maps, Budget::Count(count), sampler, seed).expect("a valid budget");
            let mut start = 0;
            for (map, chosen) in maps.iter().zip(&samples.pixels) {
                chosen.iter().for_each(|&pixel| hits[start + pixel as usize] += 1);
                start += map.values().len();
            }
        }
        hits
    };
    let parts: Vec<Vec<u32>> =
        (0..DRAWS / 100).into_par_iter().map(|i| draw(100 * i..100 * (i + 1))).collect();
    let rule = solve(maps, count as f64).expect("a valid budget");
    let p: Vec<f64> = maps.iter().flat_map(|map| rule.map(map)).collect();
    let is_wide = |&i: &usize| {
        let frequency = parts.iter().map(|hits| f64::from(hits[i])).sum::<f64>() / DRAWS as f64;
        let error = (p[i] * (1.0 - p[i]) / DRAWS as f64).sqrt();
        // Certain and impossible pixels have no error; P is rounded to 2^-31.
        (frequency - p[i]).abs() > 4.0 * error + 1e-9
    };
    ((0..pixels).filter(is_wide).count(), p.iter().filter(|&&p| p > 0.0).count())
}

fn check(maps: &[ImportanceMap], count: usize) {
    for sampler in [Sampler::Fixed, Sampler::Bernoulli, Sampler::Systematic] {
        let (wide, open) = share_beyond_4_errors(maps, count, sampler);
        assert!(wide as f64 <= 2e-4 * open as f64, "{sampler:?}, {count}: {wide} of {open} pixels");
    }
}

#[test]
fn pixels_are_chosen_as_often_as_p_says() {
    // Of 5154 pixels with P > 0, one may lie outside.
    check(&views(), 1500);
}

#[test]
fn so_they_are_where_importance_is_exhausted() {
    check(&views()[1..3], 1100);
}
