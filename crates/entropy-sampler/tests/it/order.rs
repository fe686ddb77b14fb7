use entropy_sampler::{Budget, ImportanceMap, Sampler, sample, solve};

fn views() -> [ImportanceMap; 2] {
    let values = (0..400).map(|i| 0.1 + 0.9 * (i % 20) as f32 / 20.0).collect();
    let masked = (0..300).map(|i| if i < 100 { 0.0 } else { 0.7 }).collect();
    [
        ImportanceMap::new(20, 20, values).expect("in 0..1"),
        ImportanceMap::uniform(15, 20).and_then(|map| map.with_weights(masked)).expect("in 0..1"),
    ]
}

#[test]
fn the_order_has_every_chosen_pixel_once() {
    for sampler in [Sampler::Fixed, Sampler::Bernoulli, Sampler::Systematic] {
        let samples = sample(&views(), Budget::Count(77), sampler, 4).unwrap();
        let mut order = samples.progressive();
        order.sort_unstable();
        let chosen =
            samples.pixels.iter().enumerate().flat_map(|(view, p)| p.iter().map(move |&p| (view, p)));
        assert!(order.into_iter().eq(chosen));
    }
    let none = sample(&views(), Budget::Tau(1e-12), Sampler::Fixed, 1).unwrap();
    assert_eq!(none.progressive(), []);
}

/// Over many draws, a pixel is among the first n of N as often as n / N · P says.
#[test]
fn beginnings_have_a_share_of_p() {
    const DRAWS: usize = 4000;
    let (maps, count) = (views(), 80);
    let p: Vec<Vec<f64>> = maps.iter().map(|map| solve(&maps, f64::from(count)).unwrap().map(map)).collect();
    for sampler in [Sampler::Fixed, Sampler::Bernoulli, Sampler::Systematic] {
        let mut hits = [vec![0u32; 400], vec![0u32; 300]];
        for seed in 0..DRAWS {
            let order =
                sample(&maps, Budget::Count(count as usize), sampler, seed as u64).unwrap().progressive();
            for &(view, pixel) in &order[..order.len() / 4] {
                hits[view][pixel as usize] += 1;
            }
        }
        for (p, hits) in p.iter().flatten().zip(hits.iter().flatten()) {
            let (p, frequency) = (0.25 * p, f64::from(*hits) / DRAWS as f64);
            let error = (p * (1.0 - p) / DRAWS as f64).sqrt();
            assert!((frequency - p).abs() <= 4.5 * error + 0.01 * p, "{sampler:?}: {frequency} for {p}");
        }
    }
}

/// No view comes first.
#[test]
fn beginnings_take_from_all_views() {
    let samples = sample(&views(), Budget::Count(100), Sampler::Fixed, 9).unwrap();
    let order = samples.progressive();
    for n in [20, 40, 80] {
        let share =
            |of: &dyn Fn(&&(usize, u32)) -> bool| order[..n].iter().filter(of).count() as f64 / n as f64;
        let of_first = share(&|chosen| chosen.0 == 0);
        let expected = samples.pixels[0].len() as f64 / 100.0;
        assert!((of_first - expected).abs() < 0.15, "{n}: {of_first}, expected {expected}");
    }
}

/// EvenSplat's rule: where pixels are alike, aligned cells of 2x2, 4x4 and 8x8 pixels hold equal numbers, or one more.
#[test]
fn systematic_sampling_retains_as_many_in_every_cell() {
    for (width, height, count) in [(32, 16, 13), (32, 16, 128), (32, 16, 300), (24, 40, 90), (64, 64, 1000)] {
        let maps =
            [ImportanceMap::uniform(width, height).unwrap(), ImportanceMap::uniform(width, height).unwrap()];
        let samples = sample(&maps, Budget::Count(2 * count), Sampler::Systematic, 5).unwrap();
        assert_eq!(samples.count(), 2 * count);
        for pixels in &samples.pixels {
            for side in [2, 4, 8] {
                let mut cells = vec![0usize; (width / side) * (height / side)];
                for &pixel in pixels {
                    let (x, y) = (pixel as usize % width, pixel as usize / width);
                    cells[y / side * (width / side) + x / side] += 1;
                }
                let share = (side * side * count) as f64 / (width * height) as f64;
                let allowed = (share - 1e-6).floor() as usize..=(share + 1e-6).ceil() as usize;
                assert!(
                    cells.iter().all(|n| allowed.contains(n)),
                    "{width}x{height}, {count}, {side}: {cells:?}"
                );
            }
        }
    }
}
