//! How far chosen pixels lie apart: the mean distance to the nearest other one, in units of 1 / √P, the square that a
//! pixel has for itself. Independent points have 0.5 (and more where the grid is felt), a square grid 1.

use entropy_sampler::{Budget, ImportanceMap, Probability, Sampler, sample};

const SIDE: usize = 96;

/// Spread of one view's pixels if the probability were `share` of the rule's.
fn spread(map: &ImportanceMap, rule: &Probability, share: f64, pixels: &[u32]) -> f64 {
    let p = rule.map(map);
    let at = |pixel: u32| (f64::from(pixel % SIDE as u32), f64::from(pixel / SIDE as u32));
    let distance = |&a: &u32| {
        let others = pixels.iter().filter(|&&b| a != b);
        let nearest =
            others.map(|&b| (at(a).0 - at(b).0).hypot(at(a).1 - at(b).1)).fold(f64::INFINITY, f64::min);
        nearest * (share * p[a as usize]).sqrt()
    };
    pixels.iter().map(distance).sum::<f64>() / pixels.len() as f64
}

/// Importance that rises from left to right, four times.
fn ramp() -> ImportanceMap {
    let values = (0..SIDE * SIDE).map(|i| 0.25 + 0.75 * (i % SIDE) as f32 / SIDE as f32).collect();
    ImportanceMap::new(SIDE, SIDE, values).expect("in 0..1")
}

#[test]
fn fixed_samples_lie_apart() {
    for map in [ImportanceMap::uniform(SIDE, SIDE).unwrap(), ramp()] {
        let maps = [map];
        let of = |sampler| {
            let spreads = (0..5).map(|seed| {
                let samples = sample(&maps, Budget::Count(500), sampler, seed).unwrap();
                spread(&maps[0], &samples.probability, 1.0, &samples.pixels[0])
            });
            spreads.sum::<f64>() / 5.0
        };
        let (fixed, bernoulli) = (of(Sampler::Fixed), of(Sampler::Bernoulli));
        assert!(fixed > 0.72 && bernoulli < 0.56, "{fixed} against {bernoulli}");
    }
}

/// Of the progressive order, the beginning lies apart nearly as all do, and farther than as many taken at random.
#[test]
fn the_beginning_of_the_order_lies_apart() {
    let maps = [ramp()];
    let samples = sample(&maps, Budget::Count(1200), Sampler::Fixed, 2).unwrap();
    let order: Vec<u32> = samples.progressive().into_iter().map(|(_, pixel)| pixel).collect();
    for n in [150, 300, 600, 900] {
        let share = n as f64 / 1200.0;
        let first = spread(&maps[0], &samples.probability, share, &order[..n]);
        let by_chance: Vec<u32> = (0..n).map(|i| samples.pixels[0][scattered(i)]).collect();
        let by_chance = spread(&maps[0], &samples.probability, share, &by_chance);
        assert!(first > 0.68 && first > by_chance + 0.05, "{n}: {first} against {by_chance}");
    }
}

/// A permutation of 0..1200 without any order.
fn scattered(i: usize) -> usize {
    let mut keyed: Vec<(u64, usize)> = (0..1200u64)
        .map(|k| {
            (
                (k + 1)
                    .wrapping_mul(0x9e37_79b9_7f4a_7c15)
                    .rotate_left(29)
                    .wrapping_mul(0xbf58_476d_1ce4_e5b9),
                k as usize,
            )
        })
        .collect();
    keyed.sort_unstable();
    keyed[i].1
}
