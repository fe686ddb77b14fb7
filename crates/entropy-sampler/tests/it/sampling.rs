use entropy_sampler::{Budget, ImportanceMap, Probability, Sampler, sample, solve};

fn map(width: usize, height: usize, values: &[f32]) -> ImportanceMap {
    ImportanceMap::new(width, height, values.to_vec()).expect("in 0..1")
}

#[test]
fn tau_is_solved_with_the_clip_included() {
    let maps = [map(4, 1, &[0.8, 0.4, 0.2, 0.0])];
    // Nothing saturated: tau · 1.4 = 1.4.
    assert!((solve(&maps, 1.4).unwrap().tau - 1.0).abs() < 1e-6);
    // The first saturates: 1 + tau · 0.6 = 2.2.
    let rule = solve(&maps, 2.2).unwrap();
    assert!((rule.tau - 2.0).abs() < 1e-6 && !rule.exhausts_importance());
    // All that have importance, and half of the flat pixel.
    let rule = solve(&maps, 3.5).unwrap();
    assert!((rule.tau - 5.0).abs() < 1e-6 && rule.flat == 0.5 && rule.exhausts_importance());
    assert!((rule.expected(&maps) - 3.5).abs() < 1e-9);
}

#[test]
fn weights_multiply_and_are_lifted_last() {
    let maps = [map(2, 1, &[1.0, 0.0]).with_weights(vec![0.5, 0.5]).unwrap()];
    assert_eq!(solve(&maps, 0.25).unwrap(), Probability { tau: 0.5, flat: 0.0, lift: 1.0 });
    assert_eq!(solve(&maps, 0.75).unwrap(), Probability { tau: 1.0, flat: 0.5, lift: 1.0 });
    assert_eq!(solve(&maps, 1.5).unwrap(), Probability { tau: 1.0, flat: 1.0, lift: 1.5 });
    assert_eq!(solve(&maps, 9.0).unwrap(), Probability { tau: 1.0, flat: 1.0, lift: 2.0 });
}

#[test]
fn bad_budgets_name_their_rule() {
    let maps = [ImportanceMap::uniform(3, 2).unwrap()];
    let text =
        |maps: &[ImportanceMap], budget| sample(maps, budget, Sampler::Fixed, 0).unwrap_err().to_string();
    assert_eq!(text(&maps, Budget::Count(0)), "budget is 0 pixels, expected at least 1");
    assert_eq!(text(&maps, Budget::Tau(f64::NAN)), "tau is NaN, expected a finite number above 0");
    assert_eq!(text(&maps, Budget::Tau(-1.0)), "tau is -1, expected a finite number above 0");
    assert_eq!(text(&[], Budget::Tau(0.5)), "no importance maps, expected one per view");
    assert_eq!(text(&[], Budget::Count(1)), "no importance maps, expected one per view");
    let masked = [ImportanceMap::uniform(3, 2).unwrap().with_weights(vec![0.0; 6]).unwrap()];
    assert_eq!(text(&masked, Budget::Count(1)), "every pixel has weight 0: there is nothing to sample");
    assert_eq!(
        solve(&maps, f64::INFINITY).unwrap_err().to_string(),
        "expected count is inf, it must be a finite number above 0"
    );
}

#[test]
fn flat_pictures_are_sampled_evenly() {
    let flat = [map(32, 32, &[0.0; 1024])];
    let samples = sample(&flat, Budget::Count(64), Sampler::Fixed, 5).unwrap();
    assert_eq!((samples.count(), samples.probability.tau), (64, 0.0));
    assert!((samples.probability.flat - 1.0 / 16.0).abs() < 1e-12);
    // One in each 4×4 block but for the random offset of the curve: at most 2 in any.
    for block in 0..64 {
        let inside = |&&p: &&u32| (p % 32 / 4 + p / 32 / 4 * 8) == block;
        assert!(samples.pixels[0].iter().filter(inside).count() <= 2);
    }
    assert_eq!(sample(&flat, Budget::Tau(1.0), Sampler::Fixed, 5).unwrap().count(), 0);
}

#[test]
fn a_budget_beyond_the_pixels_takes_them_all() {
    let maps = [map(3, 1, &[0.0, 1e-30, 1.0]), map(1, 1, &[0.5]).with_weights(vec![0.1]).unwrap()];
    for sampler in [Sampler::Fixed, Sampler::Bernoulli] {
        for count in [4, 5, 1_000_000_000_000] {
            let samples = sample(&maps, Budget::Count(count), sampler, 1).unwrap();
            assert_eq!(samples.pixels, [vec![0, 1, 2], vec![0]], "{sampler:?}, {count}");
            assert_eq!(samples.expected, 4.0);
        }
    }
}

#[test]
fn masked_pixels_are_never_taken() {
    let weights: Vec<f32> = (0..400).map(|i| if i % 3 == 0 { 0.0 } else { 1.0 }).collect();
    let maps = [ImportanceMap::uniform(20, 20).unwrap().with_weights(weights).unwrap()];
    for sampler in [Sampler::Fixed, Sampler::Bernoulli] {
        let samples = sample(&maps, Budget::Count(1000), sampler, 1).unwrap();
        assert!(samples.pixels[0].iter().all(|pixel| pixel % 3 != 0));
        assert_eq!(samples.count(), 266);
    }
}

/// Chosen pixels lie farther apart than independent ones: mean distance to the nearest other.
#[test]
fn fixed_samples_are_spread() {
    let maps = [ImportanceMap::uniform(64, 64).unwrap()];
    let spread = |sampler| {
        let chosen = sample(&maps, Budget::Count(256), sampler, 3).unwrap().pixels.remove(0);
        let xy: Vec<(f64, f64)> = chosen.iter().map(|&p| (f64::from(p % 64), f64::from(p / 64))).collect();
        let nearest = |i: usize| {
            (0..xy.len())
                .filter(|&j| j != i)
                .map(|j| (xy[i].0 - xy[j].0).hypot(xy[i].1 - xy[j].1))
                .fold(f64::INFINITY, f64::min)
        };
        (0..xy.len()).map(nearest).sum::<f64>() / xy.len() as f64
    };
    let (fixed, bernoulli) = (spread(Sampler::Fixed), spread(Sampler::Bernoulli));
    assert!(fixed > 1.2 * bernoulli, "{fixed} against {bernoulli} px");
}
