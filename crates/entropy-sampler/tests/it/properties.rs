use entropy_sampler::{Border, Budget, EntropyWindow, ImportanceMap, Sampler, entropy, sample, solve};
use proptest::prelude::*;

/// The definition: a histogram per pixel, in f64.
fn entropy_by_definition(grey: &[u8], width: usize, height: usize, window: EntropyWindow) -> Vec<f64> {
    let radius = window.size as isize / 2;
    let seen = |i: isize, n: usize| -> Option<usize> {
        let n = n as isize;
        let mut i = i;
        if window.border == Border::Clip {
            return (0..n).contains(&i).then_some(i as usize);
        }
        while !(0..n).contains(&i) {
            i = if n == 1 {
                0
            } else if i < 0 {
                -i
            } else {
                2 * (n - 1) - i
            };
        }
        Some(i as usize)
    };
    let mut out = Vec::new();
    for y in 0..height as isize {
        for x in 0..width as isize {
            let mut counts = vec![0usize; window.levels];
            for dy in -radius..=radius {
                for dx in -radius..=radius {
                    if let (Some(sx), Some(sy)) = (seen(x + dx, width), seen(y + dy, height)) {
                        counts[usize::from(grey[sy * width + sx]) * window.levels / 256] += 1;
                    }
                }
            }
            let n = counts.iter().sum::<usize>() as f64;
            let share = counts.iter().filter(|&&c| c > 0).map(|&c| c as f64 / n);
            out.push(share.map(|p| -p * p.log2()).sum());
        }
    }
    out
}

/// One to three views of random size, importance with many zeros and saturated values, weights now and then.
fn views() -> impl Strategy<Value = Vec<ImportanceMap>> {
    let value = prop_oneof![Just(0.0f32), Just(1.0f32), 0.0..1.0f32, Just(1e-38f32)];
    let view = (1..24usize, 1..24usize).prop_flat_map(move |(width, height)| {
        let values = prop::collection::vec(value.clone(), width * height);
        let weights = prop::option::of(prop::collection::vec(
            prop_oneof![Just(0.0f32), Just(1.0f32), 0.0..1.0f32],
            width * height,
        ));
        (values, weights).prop_map(move |(values, weights)| {
            let map = ImportanceMap::new(width, height, values).expect("in 0..1");
            match weights {
                Some(weights) => map.with_weights(weights).expect("in 0..1"),
                None => map,
            }
        })
    });
    prop::collection::vec(view, 1..4)
}

fn usable(maps: &[ImportanceMap]) -> usize {
    let in_map = |map: &ImportanceMap| {
        map.weights().map_or(map.values().len(), |w| w.iter().filter(|&&w| w > 0.0).count())
    };
    maps.iter().map(in_map).sum()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn entropy_equals_its_definition(
        (width, height, grey) in (1..20usize, 1..20usize).prop_flat_map(|(w, h)| {
            (Just(w), Just(h), prop::collection::vec(prop_oneof![0..4u8, any::<u8>()], w * h))
        }),
        radius in 0..6usize, levels in 2..=256usize, clip: bool,
    ) {
        let border = if clip { Border::Clip } else { Border::Reflect };
        let window = EntropyWindow { size: 2 * radius + 1, levels, border };
        let found = entropy(&grey, width, height, window).unwrap();
        for (a, b) in found.iter().zip(entropy_by_definition(&grey, width, height, window)) {
            prop_assert!((f64::from(*a) - b).abs() < 1e-6, "{a} {b}");
        }
    }

    #[test]
    fn the_expected_count_is_the_budget(maps in views(), share in 0.0..1.2f64) {
        let usable = usable(&maps) as f64;
        prop_assume!(usable > 0.0);
        let target = (share * usable).max(1e-3);
        let rule = solve(&maps, target).unwrap();
        let expected = rule.expected(&maps);
        prop_assert!((expected - target.min(usable)).abs() < 1e-9 * usable.max(1.0), "{expected}, {target}, {rule:?}");
    }

    #[test]
    fn fixed_takes_exactly_the_budget(maps in views(), share in 0.0..1.2f64, seed: u64) {
        let usable = usable(&maps);
        prop_assume!(usable > 0);
        let count = ((share * usable as f64) as usize).max(1);
        let samples = sample(&maps, Budget::Count(count), Sampler::Fixed, seed).unwrap();
        prop_assert_eq!(samples.count(), count.min(usable));
        for (map, pixels) in maps.iter().zip(&samples.pixels) {
            prop_assert!(pixels.is_sorted_by(|a, b| a < b));
            let p = samples.probability.map(map);
            prop_assert!(pixels.iter().all(|&pixel| p[pixel as usize] > 0.0));
            // Each view's count is its own expectation, rounded up or down.
            prop_assert!((pixels.len() as f64 - p.iter().sum::<f64>()).abs() < 1.0 + 1e-6);
        }
    }

    #[test]
    fn a_tau_gives_its_expected_count_rounded(maps in views(), tau in 0.01..20.0f64, seed: u64) {
        let samples = sample(&maps, Budget::Tau(tau), Sampler::Fixed, seed).unwrap();
        prop_assert!((samples.count() as f64 - samples.expected).abs() < 1.0 + 1e-6);
    }

    #[test]
    fn threads_do_not_change_the_samples(maps in views(), seed: u64, fixed: bool) {
        let sampler = if fixed { Sampler::Fixed } else { Sampler::Bernoulli };
        prop_assume!(usable(&maps) > 0);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| sample(&maps, Budget::Count(100), sampler, seed).unwrap())
        };
        prop_assert_eq!(on(1), on(2));
    }
}

/// Both samplers choose each pixel as often as P says.
#[test]
fn marginals_are_p() {
    const DRAWS: u64 = 4000;
    let values: Vec<f32> =
        (0..16 * 16).map(|i| (i % 16) as f32 / 16.0 * if i < 128 { 1.0 } else { 0.3 }).collect();
    let maps = [
        ImportanceMap::new(16, 16, values).unwrap(),
        ImportanceMap::uniform(5, 3)
            .unwrap()
            .with_weights((0..15).map(|i| i as f32 / 15.0).collect())
            .unwrap(),
    ];
    for sampler in [Sampler::Fixed, Sampler::Bernoulli] {
        let mut hits: Vec<Vec<u32>> = maps.iter().map(|map| vec![0; map.values().len()]).collect();
        let mut total = 0;
        for seed in 0..DRAWS {
            let samples = sample(&maps, Budget::Count(90), sampler, seed).unwrap();
            total += samples.count();
            for (hits, pixels) in hits.iter_mut().zip(&samples.pixels) {
                pixels.iter().for_each(|&pixel| hits[pixel as usize] += 1);
            }
        }
        let rule = solve(&maps, 90.0).unwrap();
        let mut wide = 0;
        for (map, hits) in maps.iter().zip(&hits) {
            for (p, &hits) in rule.map(map).into_iter().zip(hits) {
                let frequency = f64::from(hits) / DRAWS as f64;
                let error = (p * (1.0 - p) / DRAWS as f64).sqrt();
                assert!((frequency - p).abs() <= 5.0 * error + 1e-9, "{sampler:?}: {frequency} for P = {p}");
                wide += usize::from((frequency - p).abs() > 3.0 * error + 1e-9);
            }
        }
        assert!(wide <= 8, "{sampler:?}: {wide} of 271 pixels beyond 3 standard errors");
        let mean = total as f64 / DRAWS as f64;
        assert!((mean - 90.0).abs() < 0.6, "{sampler:?}: {mean} on the mean");
    }
}
