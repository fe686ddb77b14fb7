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
    "MonoGS prints a mean of 38.94 dB, SSIM 0.968, in its table 5. Its scenes of table 7 have the mean that stands here.",
    "The paper of GS-ICP SLAM was not at hand: its row is from a survey and a summary that agree.",
];

/// What `stream --evaluate --json` wrote, as far as it is needed here.
#[derive(Debug, Deserialize)]
struct Stream {
    recipe: Recipe,
    input: String,
    gaussians: usize,
    latency: Latency,
    measured: Option<Measured>,
}

#[derive(Debug, Deserialize)]
struct Recipe {
    threads: usize,
    machine: Machine,
}

#[derive(Debug, Deserialize)]
struct Machine {
    cpu: Option<String>,
}

/// Means over the streams that were given.
#[derive(Debug, Serialize)]
struct Ours {
    inputs: Vec<String>,
    /// Of the first stream.
    machine: String,
    gaussians: f64,
    /// Mean over the streams of the median latency of a keyframe, seconds.
    keyframe_seconds: f64,
    mapped: Means,
    between: Means,
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
            let measured = stream.measured.take().ok_or_else(|| {
                Failure::input(format!(
                    "{}: nothing was measured: run `stream` with --evaluate",
                    path.display()
                ))
            })?;
            Ok((stream, measured))
        };
        let all = paths.iter().map(read).collect::<Outcome<Vec<_>>>()?;
        let ours = Ours::mean(&all);
        let mut notes: Vec<String> = NOTES.iter().map(|&note| note.to_owned()).collect();
        notes.push(match &ours {
            None => "No stream was given: `stream REPLICA/room0 --evaluate --json room0.json`, then --stream room0.json.".to_owned(),
            Some(ours) => format!("Streams: {}.", ours.inputs.join(", ")),
        });
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

impl Ours {
    fn mean(all: &[(Stream, Measured)]) -> Option<Self> {
        let n = all.len() as f64;
        let over = |of: &dyn Fn(&(Stream, Measured)) -> f64| all.iter().map(of).sum::<f64>() / n;
        let means = |of: fn(&Measured) -> &Means| Means {
            frames: all.iter().map(|(_, measured)| of(measured).frames).sum(),
            psnr: over(&|(_, measured)| of(measured).psnr),
            ssim: over(&|(_, measured)| of(measured).ssim),
            // Where one stream has none, there is no mean.
            lpips: Some(over(&|(_, measured)| of(measured).lpips.unwrap_or(f64::NAN)))
                .filter(|mean| mean.is_finite()),
            depth_l1: Some(over(&|(_, measured)| of(measured).depth_l1.unwrap_or(f64::NAN)))
                .filter(|mean| mean.is_finite()),
        };
        let (stream, first) = all.first()?;
        let Recipe { threads, machine: Machine { cpu } } = &stream.recipe;
        let machine = format!("{}, {threads} threads", cpu.as_deref().unwrap_or("CPU"));
        let network = first.lpips_network.clone();
        let is_one = all.iter().all(|(_, measured)| measured.lpips_network == network);
        Some(Self {
            inputs: all.iter().map(|(stream, _)| stream.input.clone()).collect(),
            machine,
            gaussians: over(&|(stream, _)| stream.gaussians as f64),
            keyframe_seconds: over(&|(stream, _)| stream.latency.keyframe_median),
            mapped: means(|measured| &measured.mapped),
            between: means(|measured| &measured.between),
            lpips_network: network.filter(|_| is_one),
        })
    }
}
