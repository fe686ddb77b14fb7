//! `bench entropy`: importance of pixels, and choosing them.

use super::cpu::{self, Job, OURS};
use super::measure::pools;
use super::random::Random;
use crate::arguments::{Common, gaussians as count_above_0, positive, size};
use crate::failure::{OrFail, Outcome};
use crate::progress::Progress;
use crate::summary::print;
use clap::Args;
use entropy_sampler::{Border, Budget, EntropyWindow, ImportanceMap, Sampler, entropy, sample, solve};
use rayon::prelude::*;
use report_parts::count;
use serde::Serialize;
use std::hint::black_box;

/// Importance of pixels and choosing them: time per pixel of the entropy of six views, of the budget and the samplers
///
/// Views are textured, flat, or noise; the window is 7x7. Beside it the definition, a histogram for every window, on as many
/// threads. Budgets and samplers work on the textured views; that the budget is solved is part of what a sampler takes.
#[derive(Debug, Args)]
#[command(arg = crate::arguments::no_device(), after_help = "Examples:\n  sparsesplat bench entropy\n  \
                        sparsesplat bench entropy --budgets 40k --runs 21 --json entropy.json")]
pub(crate) struct Arguments {
    /// How many pixels are chosen
    #[arg(long, value_name = "N,M,...", value_parser = count_above_0, value_delimiter = ',', default_value = "40k,150k")]
    budgets: Vec<usize>,
    /// Size of the six views
    #[arg(long, value_name = "WxH", value_parser = size, default_value = "448x256")]
    size: (usize, usize),
    /// Timed runs of each row
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 9)]
    runs: usize,
}

const VIEWS: usize = 6;

/// Makes a grey value of (place, column, row, view).
type Texture = fn(&mut Random, f64, f64, usize) -> f64;

/// What is in the views; samplers work on the first.
const CONTENTS: [(&str, Texture); 3] =
    [("textured", textured), ("flat", |_, _, _, _| 90.0), ("noise", noise)];

const BORDERS: [(&str, Border); 2] = [("reflect", Border::Reflect), ("clip", Border::Clip)];

const SAMPLERS: [(&str, Sampler); 2] = [("fixed", Sampler::Fixed), ("bernoulli", Sampler::Bernoulli)];

#[derive(Serialize)]
struct Settings<'a> {
    budgets: &'a [usize],
    width: usize,
    height: usize,
    views: usize,
    runs: usize,
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let &Arguments { ref budgets, size: (width, height), runs } = arguments;
    let pools = pools()?;
    let contents: Vec<Vec<Vec<u8>>> =
        CONTENTS.iter().map(|(_, texture)| views(*texture, width, height)).collect();
    let maps: Vec<ImportanceMap> = contents[0]
        .iter()
        .map(|view| ImportanceMap::entropy(view, width, height, EntropyWindow::default()))
        .collect::<Result<_, _>>()
        .or_input()?;
    let pixels = (VIEWS * width * height, None);

    let mut jobs = Vec::new();
    for pool in &pools {
        for ((name, _), views) in CONTENTS.iter().zip(&contents) {
            for (border_name, border) in BORDERS {
                let window = EntropyWindow { border, ..EntropyWindow::default() };
                let case = format!("entropy, {name}, {border_name}");
                let ours = move || {
                    for view in views {
                        black_box(entropy(view, width, height, window).or_work()?);
                    }
                    Ok(())
                };
                let naive = move || {
                    for view in views {
                        black_box(by_definition(view, width, height, window));
                    }
                    Ok(())
                };
                jobs.push(Job::new(OURS, &*case, pixels, pool, ours));
                jobs.push(Job::new("ours-naive", case, pixels, pool, naive));
            }
        }
        let maps = &maps;
        for &budget in budgets {
            let amount = count(budget as f64);
            let solved = move || solve(maps, budget as f64).map(drop).or_work();
            jobs.push(Job::new(OURS, format!("budget of {amount}"), pixels, pool, solved));
            for (name, sampler) in SAMPLERS {
                let sampled = move || sample(maps, Budget::Count(budget), sampler, 0).map(drop).or_work();
                jobs.push(Job::new(OURS, format!("{name} sample of {amount}"), pixels, pool, sampled));
            }
        }
    }
    let progress = Progress::new(runs * jobs.len());
    let rows = cpu::rows("entropy", &jobs, runs, &progress)?;
    drop(progress);
    print(&cpu::table(&rows, "pixels").to_text());
    cpu::write(common, Settings { budgets, width, height, views: VIEWS, runs }, &rows, ())
}

fn views(texture: Texture, width: usize, height: usize) -> Vec<Vec<u8>> {
    let view = |view: usize| {
        let mut random = Random(view as u64);
        let mut grey = |i: usize| texture(&mut random, (i % width) as f64, (i / width) as f64, view) as u8;
        (0..width * height).map(&mut grey).collect()
    };
    (0..VIEWS).map(view).collect()
}

/// Smooth shading under fine and coarse grain, in a pattern of squares.
fn textured(random: &mut Random, x: f64, y: f64, view: usize) -> f64 {
    let shading = 128.0 + 60.0 * (x / 40.0).sin() * (y / 30.0 + view as f64).cos();
    let grain = if (x as usize / 64 + y as usize / 64).is_multiple_of(2) { 2.0 } else { 15.0 };
    shading + grain * f64::from(random.unit())
}

fn noise(random: &mut Random, _: f64, _: f64, _: usize) -> f64 {
    (random.next() >> 56) as f64
}

/// The definition, for 256 levels: bits of every window from its histogram.
fn by_definition(grey: &[u8], width: usize, height: usize, window: EntropyWindow) -> Vec<f32> {
    let inside = |i: isize, n: usize| match window.border {
        Border::Clip => usize::try_from(i).ok().filter(|&i| i < n),
        Border::Reflect => Some(mirrored(i, n)),
    };
    let radius = (window.size / 2) as isize;
    let entropy = |x: usize, y: usize| {
        let mut histogram = [0u32; 256];
        for row in (-radius..=radius).filter_map(|dy| inside(y as isize + dy, height)) {
            for column in (-radius..=radius).filter_map(|dx| inside(x as isize + dx, width)) {
                histogram[usize::from(grey[row * width + column])] += 1;
            }
        }
        let pixels = f64::from(histogram.iter().sum::<u32>());
        let shares = histogram.iter().filter(|&&count| count > 0).map(|&count| f64::from(count) / pixels);
        // Of a flat window the sum is -0.
        shares.map(|share| -share * share.log2()).sum::<f64>().max(0.0) as f32
    };
    let mut bits = vec![0.0; grey.len()];
    bits.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        for (x, bits) in row.iter_mut().enumerate() {
            *bits = entropy(x, y);
        }
    });
    bits
}

/// The place that is seen at `i` when `n` pixels are mirrored at the edge pixels, again and again.
fn mirrored(i: isize, n: usize) -> usize {
    let period = (2 * n as isize - 2).max(1);
    let i = i.rem_euclid(period) as usize;
    i.min(period as usize - i).min(n - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_definition_agrees() {
        for (width, height) in [(40, 30), (9, 3), (2, 5), (1, 1)] {
            for (_, texture) in CONTENTS {
                let view = &views(texture, width, height)[1];
                for (_, border) in BORDERS {
                    let window = EntropyWindow { border, ..EntropyWindow::default() };
                    let expected = by_definition(view, width, height, window);
                    let found = entropy(view, width, height, window).unwrap();
                    let worst = found.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                    assert!(worst < 1e-5, "{width}x{height}, {border:?}: {worst}");
                }
            }
        }
    }
}
