//! Mapping systems on Replica: what their authors publish, with streams of ours beside.

use crate::failure::{Failure, OrFail, Outcome};
use crate::stream::{Latency, Means, Measured};
use anyhow::Context;
use report_parts::{Table, count, number};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::PathBuf;

/// Title of the table.
pub(super) const TITLE: &str = "Mapping systems on Replica, streams beside";

/// Means over eight sequences of Replica (room0 to room2, office0 to office4), 1200x680.
#[derive(Debug, Serialize)]
struct Published {
    system: &'static str,
    /// Which frames are rendered.
    frames: &'static str,
    psnr: f64,
    ssim: f64,
    lpips: f64,
    speed: &'static str,
    machine: &'static str,
    source: &'static str,
}

const PUBLISHED: [Published; 5] = [
    Published {
        system: "Photo-SLAM, RGB-D",
        frames: "all",
        psnr: 34.958,
        ssim: 0.942,
        lpips: 0.059,
        speed: "tracking 42 frames/s",
        machine: "RTX 4090, Core i9-13900K",
        source: "arXiv 2311.16728, table 1",
    },
    Published {
        system: "Photo-SLAM, monocular",
        frames: "all",
        psnr: 33.302,
        ssim: 0.926,
        lpips: 0.078,
        speed: "tracking 42 frames/s",
        machine: "RTX 4090, Core i9-13900K",
        source: "arXiv 2311.16728, table 1",
    },
    Published {
        system: "MonoGS, RGB-D",
        frames: "every 5th but keyframes",
        psnr: 37.50,
        ssim: 0.960,
        lpips: 0.070,
        speed: "1.8 frames/s (office1)",
        machine: "RTX 4090, Core i9-12900K",
        source: "arXiv 2312.06741, tables 7 and 10",
    },
    Published {
        system: "SplaTAM, RGB-D",
        frames: "every 5th, all mapped",
        psnr: 34.11,
        ssim: 0.97,
        lpips: 0.10,
        speed: "2.4 s a frame (room0)",
        machine: "RTX 3080 Ti",
        source: "arXiv 2312.02126, tables 2 and 6",
    },
    Published {
        system: "GS-ICP SLAM, RGB-D",
        frames: "all",
        psnr: 38.83,
        ssim: 0.975,
        lpips: 0.041,
        speed: "30 frames/s, its limit",
        machine: "RTX 4090, Ryzen 7 7800X3D",
        source: "arXiv 2403.12550, as others quote it",
    },
];

/// What has to be known to read the table.
const NOTES: [&str; 4] = [
    "The published figures are means over room0 to room2 and office0 to office4 of Replica, 1200x680. These systems find their cameras; ours are given.",
    "Frames, masks and networks differ: SplaTAM and GS-ICP SLAM leave out pixels without depth, MonoGS black ones. LPIPS is by AlexNet; Photo-SLAM \
     gives it colours from 0 to 1, the others from -1 to 1. SplaTAM's SSIM is multi-scale.",
    "MonoGS prints a mean of 38.94 dB, SSIM 0.968, in its table 5. The row has the mean of the scenes in its table 7.",
    "We did not have the paper of GS-ICP SLAM: its row is quoted from two secondary sources, which agree.",
];

const NO_STREAM: &str =
    "No stream was given: `stream REPLICA/room0 --evaluate --json room0.json`, then --stream room0.json.";

/// What `stream --evaluate --json` wrote, as far as it is needed here.
#[derive(Debug, Deserialize)]
struct Stream {
    recipe: Recipe,
    input: String,
    size: [usize; 2],
    first_frame: usize,
    frames: usize,
    gaussians: usize,
    interrupted: bool,
    broken: Option<String>,
    latency: Latency,
    measured: Option<Measured>,
}

#[derive(Debug, Deserialize)]
struct Recipe {
    git: String,
    threads: usize,
    machine: Machine,
    config: mapper::Config,
}

#[derive(Debug, Deserialize)]
struct Machine {
    cpu: Option<String>,
}

/// Means over the streams that were given.
#[derive(Debug, Serialize)]
struct Ours {
    inputs: Vec<String>,
    machine: String,
    gaussians: f64,
    /// Mean over the streams of the median latency of a keyframe, seconds.
    keyframe_seconds: f64,
    /// None where no stream has such frames.
    mapped: Option<Means>,
    between: Option<Means>,
    /// None where it is not known, or not the same for all.
    lpips_network: Option<String>,
}

/// The table.
#[derive(Debug, Serialize)]
pub(super) struct Mapping {
    published: &'static [Published],
    ours: Option<Ours>,
    notes: Vec<String>,
}

impl Mapping {
    /// Reads the records of streams.
    pub(super) fn read(paths: &[PathBuf]) -> Outcome<Self> {
        let read = |path: &PathBuf| -> Outcome<(Stream, Measured)> {
            let text = fs::read(path).with_context(|| path.display().to_string()).or_input()?;
            let record: serde_json::Result<Stream> = serde_json::from_slice(&text);
            let what = || format!("{}: not a record of `stream --json`", path.display());
            let mut stream = record.with_context(what).or_input()?;
            let wrong = |rule: String| Failure::input(format!("{}: {rule}", path.display()));
            if let Some(reason) = &stream.broken {
                return Err(wrong(format!("the stream broke off: {reason}")));
            }
            if stream.interrupted || stream.first_frame > 0 {
                return Err(wrong(
                    "not the record of a whole stream: it was interrupted or resumed".to_owned(),
                ));
            }
            let measured = stream.measured.take();
            let measured = measured
                .ok_or_else(|| wrong("nothing was measured: run `stream` with --evaluate".to_owned()))?;
            Ok((stream, measured))
        };
        let all = paths.iter().map(read).collect::<Outcome<Vec<_>>>()?;
        let ours = Ours::mean(&all);
        let mut notes: Vec<String> = NOTES.iter().map(|&note| note.to_owned()).collect();
        notes.extend(all.iter().map(|(stream, _)| stream.note()));
        if ours.is_none() {
            notes.push(NO_STREAM.to_owned());
        }
        Ok(Self { published: &PUBLISHED, ours, notes })
    }

    pub(super) fn notes(&self) -> &[String] {
        &self.notes
    }

    pub(super) fn table(&self) -> Table {
        let head = ["system", "frames", "PSNR", "SSIM", "LPIPS", "Gaussians", "speed", "machine", "source"];
        let mut table = Table::new(&head, 2);
        for row in self.published {
            let figures = [number(row.psnr, 2), number(row.ssim, 3), number(row.lpips, 3), "-".to_owned()];
            let words = [row.speed, row.machine, row.source].map(str::to_owned);
            table.push(
                [[row.system, row.frames].map(str::to_owned).to_vec(), figures.to_vec(), words.to_vec()]
                    .concat(),
            );
        }
        let Some(ours) = &self.ours else { return table };
        for (frames, means) in [("keyframes", &ours.mapped), ("between keyframes", &ours.between)] {
            let Some(means) = means else { continue };
            let lpips = match (&ours.lpips_network, means.lpips) {
                (Some(network), Some(lpips)) => format!("{} ({network})", number(lpips, 3)),
                _ => "-".to_owned(),
            };
            table.push(vec![
                "sparsesplat stream, poses given".to_owned(),
                frames.to_owned(),
                number(means.psnr, 2),
                number(means.ssim, 3),
                lpips,
                count(ours.gaussians),
                format!("{} s a keyframe", number(ours.keyframe_seconds, 2)),
                ours.machine.clone(),
                "measured".to_owned(),
            ]);
        }
        table
    }
}

impl Stream {
    /// What the stream was.
    fn note(&self) -> String {
        let [width, height] = self.size;
        let mapper::Config { cap, depth, tau, refine, seed, .. } = self.recipe.config;
        let depth = match depth {
            mapper::Depth::Measured => "measured depth",
            mapper::Depth::Stereo => "stereo",
        };
        format!(
            "{}: {} frames of {width}x{height}, {depth}, cap {}, tau {tau}, {refine} steps per keyframe, seed {seed}, commit {}.",
            self.input,
            self.frames,
            count(cap as f64),
            self.recipe.git
        )
    }

    fn machine(&self) -> String {
        let Recipe { threads, machine: Machine { cpu }, .. } = &self.recipe;
        format!("{}, {threads} threads", cpu.as_deref().unwrap_or("CPU"))
    }
}

impl Ours {
    fn mean(all: &[(Stream, Measured)]) -> Option<Self> {
        let (stream, first) = all.first()?;
        let over = |value: &dyn Fn(&Stream) -> f64| {
            all.iter().map(|(stream, _)| value(stream)).sum::<f64>() / all.len() as f64
        };
        let machine = stream.machine();
        let is_one_machine = all.iter().all(|(stream, _)| stream.machine() == machine);
        let network = first.lpips_network.clone();
        let is_one_network = all.iter().all(|(_, measured)| measured.lpips_network == network);
        Some(Self {
            inputs: all.iter().map(|(stream, _)| stream.input.clone()).collect(),
            machine: if is_one_machine { machine } else { "several".to_owned() },
            gaussians: over(&|stream| stream.gaussians as f64),
            keyframe_seconds: over(&|stream| stream.latency.keyframe_median),
            mapped: mean(all.iter().map(|(_, measured)| &measured.mapped)),
            between: mean(all.iter().map(|(_, measured)| &measured.between)),
            lpips_network: network.filter(|_| is_one_network),
        })
    }
}

/// The mean over streams that have such frames.
fn mean<'a>(all: impl Iterator<Item = &'a Means>) -> Option<Means> {
    let all: Vec<&Means> = all.filter(|means| means.frames > 0).collect();
    let over =
        |value: fn(&Means) -> f64| all.iter().map(|means| value(means)).sum::<f64>() / all.len() as f64;
    // Where one stream has none, there is no mean.
    let if_all = |value: fn(&Means) -> Option<f64>| {
        let values: Option<Vec<f64>> = all.iter().map(|means| value(means)).collect();
        values.map(|values| values.iter().sum::<f64>() / values.len() as f64)
    };
    (!all.is_empty()).then(|| Means {
        frames: all.iter().map(|means| means.frames).sum(),
        psnr: over(|means| means.psnr),
        ssim: over(|means| means.ssim),
        lpips: if_all(|means| means.lpips),
        depth_l1: if_all(|means| means.depth_l1),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_is_of_the_streams_that_have_such_frames() {
        let means = |frames, psnr, lpips| Means { frames, psnr, ssim: psnr / 100.0, lpips, depth_l1: None };
        let all = [means(3, 20.0, Some(0.2)), means(0, 0.0, None), means(5, 30.0, Some(0.4))];
        let found = mean(all.iter()).unwrap();
        assert_eq!((found.frames, found.psnr, found.ssim), (8, 25.0, 0.25));
        assert!((found.lpips.unwrap() - 0.3).abs() < 1e-12 && found.depth_l1.is_none());
        let found = mean([means(3, 20.0, Some(0.2)), means(1, 10.0, None)].iter()).unwrap();
        assert_eq!((found.psnr, found.lpips), (15.0, None));
        assert!(mean([means(0, 0.0, None)].iter()).is_none());
    }
}
