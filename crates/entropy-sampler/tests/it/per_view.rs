use entropy_sampler::{Budget, Error, ImportanceMap, Sampler, sample_per_view};

/// Textured, flat, saturated, mostly masked, and masked altogether.
fn views() -> Vec<ImportanceMap> {
    let textured = ImportanceMap::new(16, 12, (0..192).map(|i| (i % 13) as f32 / 13.0).collect());
    let flat = ImportanceMap::new(10, 10, vec![0.0; 100]);
    let saturated = ImportanceMap::uniform(9, 7);
    let mask = |n: usize| (0..64).map(|i| f32::from(u8::from(i < n))).collect();
    let masked = |n: usize| ImportanceMap::uniform(8, 8).and_then(|map| map.with_weights(mask(n)));
    [textured, flat, saturated, masked(5), masked(0)].map(|map| map.expect("in 0..1")).into()
}

#[test]
fn every_view_has_its_own_count() {
    let maps = views();
    for sampler in [Sampler::Fixed, Sampler::Bernoulli, Sampler::Systematic] {
        let samples = sample_per_view(&maps, &[30, 20, 63, 9, 3], sampler, 8).unwrap();
        let expected: Vec<f64> = samples.iter().map(|samples| samples.expected).collect();
        for (found, count) in expected.iter().zip([30.0, 20.0, 63.0, 5.0, 0.0]) {
            assert!((found - count).abs() < 1e-9, "{expected:?}");
        }
        assert!(samples.iter().all(|samples| samples.pixels.len() == 1));
        // Certain whatever the sampler: all of the saturated view, the five pixels that are not masked.
        assert_eq!(samples[2].pixels, [(0..63).collect::<Vec<u32>>()]);
        assert_eq!(samples[3].pixels, [vec![0, 1, 2, 3, 4]]);
        assert_eq!(samples[4].pixels, [Vec::<u32>::new()]);
        if sampler == Sampler::Fixed {
            assert_eq!(samples.iter().map(|samples| samples.count()).collect::<Vec<_>>(), [30, 20, 63, 5, 0]);
        }
    }
}

#[test]
fn a_count_of_0_takes_none() {
    let samples = sample_per_view(&views()[..2], &[0, 7], Sampler::Fixed, 1).unwrap();
    assert_eq!(samples.iter().map(|samples| samples.count()).collect::<Vec<_>>(), [0, 7]);
    assert_eq!(samples[0].progressive(), []);
}

#[test]
fn equal_views_are_drawn_differently() {
    let maps = vec![ImportanceMap::uniform(40, 40).unwrap(); 2];
    for sampler in [Sampler::Fixed, Sampler::Bernoulli] {
        let samples = sample_per_view(&maps, &[50, 50], sampler, 1).unwrap();
        assert_ne!(samples[0].pixels, samples[1].pixels);
        let together = entropy_sampler::sample(&maps, Budget::Count(100), sampler, 1).unwrap();
        assert_ne!(together.pixels[0], together.pixels[1]);
    }
}

#[test]
fn bad_counts_name_their_rule() {
    let maps = views();
    let error = |maps: &[ImportanceMap], counts: &[usize]| {
        sample_per_view(maps, counts, Sampler::Fixed, 0).unwrap_err()
    };
    assert_eq!(error(&maps, &[1, 2]).to_string(), "2 counts, expected one for each of 5 maps");
    assert_eq!(error(&maps, &[0; 5]), Error::EmptyBudget);
    assert_eq!(error(&maps[4..], &[5]), Error::NoUsablePixel);
    assert_eq!(error(&[], &[]), Error::NoMaps);
}
