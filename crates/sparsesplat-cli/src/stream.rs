//! `stream`: posed frames, one after the other, to a bounded map.

mod measure;
mod plot;
mod protocol;
mod source;

use crate::arguments::{Common, LpipsWeights, gaussians, positive, size};
use crate::failure::{Failure, OrFail, Outcome};
use crate::output::{self, Outputs, named};
use crate::progress::Progress;
use crate::summary::{memory_line, print_line};
use clap::{Args, ValueEnum};
use evaluate::{Recipe, peak_rss_bytes};
use mapper::{Config, Depth, Integrated, Mapper, Outcome as Of, Update};
use measure::Row;
pub(crate) use measure::{Means, Measured};
use report_parts::count;
use serde::{Deserialize, Serialize};
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use source::{Next, Source};
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use view_data::Format;

/// Map posed frames as they come, into a set of Gaussians that never exceeds a cap
///
/// INPUT is a data set whose frames have an order (nerfstudio, COLMAP, Replica, TUM RGB-D, ScanNet, DL3DV, RealEstate10K), a folder that
/// another program fills (--watch), or `-` for standard input. Poses are given: nothing is tracked. A frame changes the map if it shows
/// something that the map does not; a second round over the same path adds little.
///
/// Ctrl-C writes the map and the snapshot, and ends the command; --resume goes on from the snapshot to the map of an uninterrupted run.
#[derive(Debug, Args)]
#[command(arg = crate::arguments::no_device(), after_help = crate::arguments::SEE_LONG_HELP, after_long_help = "Examples:\n  \
    sparsesplat stream --demo -o dwelling.ply                       a simulated walk through four rooms, twice\n  \
    sparsesplat stream Replica/room0 --cap 200k -o room0.ply\n  \
    sparsesplat stream data/fox --depth stereo --refine 5 -o fox.ply --log fox.jsonl\n  \
    camera-program | sparsesplat stream - -o map.ply                frames from standard input\n  \
    sparsesplat stream incoming --watch -o map.ply                  frames that appear in a folder, until a file `end` does\n  \
    sparsesplat stream data/kitchen --resume map.snapshot -o map.ply\n\n\
    A frame on standard input is its length in bytes (32 bits, little endian), and then one line of JSON, the picture, and the depth:\n  \
    {\"name\": \"0\", \"time\": 0.0, \"width\": W, \"height\": H, \"fl_x\": F, \"fl_y\": F, \"cx\": X, \"cy\": Y,\n   \
    \"world_to_camera\": [[r, r, r, t], [r, r, r, t], [r, r, r, t]], \"depth\": true}\n  \
    on one line with a line feed at its end; W*H*3 bytes RGB; with \"depth\": true, W*H z-depths (32-bit floats, little endian,\n  \
    0 = none). Axes are OpenCV's; time (seconds) and depth may be left out. A length of 0 or the end of the input ends the stream.\n  \
    In a watched folder the same without the length is a file NAME.frame. Write it under another name and rename it.")]
pub(crate) struct Arguments {
    /// Data set, watched folder, or - for standard input
    #[arg(required_unless_present = "demo", conflicts_with = "demo")]
    input: Option<PathBuf>,
    /// Simulate a walk through a dwelling of four rooms that goes round twice
    #[arg(long)]
    demo: bool,
    /// Take frames from files NAME.frame as they appear in INPUT, in the order of their names, until there is a file `end`
    #[arg(long, requires = "input")]
    watch: bool,
    /// End a watched folder after so many seconds without a new frame
    #[arg(long, value_name = "S", requires = "watch", value_parser = positive)]
    idle: Option<usize>,
    /// Layout of the data set: nerfstudio, colmap, replica, tum, scannet, chunk, dl3dv or re10k [default: recognised by its files]
    #[arg(long, value_name = "LAYOUT", conflicts_with_all = ["watch", "demo"])]
    format: Option<Format>,
    /// Scale and crop the frames of a data set or of the demo to this size
    #[arg(long, value_name = "WxH", value_parser = size)]
    size: Option<(usize, usize)>,
    /// Take this many frames at the most; of the demo, along the whole path [default: all; 300]
    #[arg(long, value_name = "N", value_parser = positive)]
    frames: Option<usize>,
    /// Map to write: .ply, .compressed.ply, .spz, .splat or .glb
    #[arg(short, long, value_name = "SCENE")]
    output: PathBuf,
    /// Most Gaussians that the map ever holds
    #[arg(long, value_name = "COUNT", value_parser = gaussians, default_value = "200k")]
    cap: usize,
    /// Most bytes that the map ever holds, 68 per Gaussian: 10M
    #[arg(long, value_name = "BYTES", value_parser = gaussians)]
    max_bytes: Option<usize>,
    /// Source of depth [default: measured if the first frame has depth]
    #[arg(long, value_enum)]
    depth: Option<DepthName>,
    /// Sampling parameter: probability of a pixel that the map does not show = tau x entropy / 8 bits
    #[arg(long, default_value_t = Config::default().tau, allow_hyphen_values = true)]
    tau: f64,
    /// Keyframes that stereo matches with each other, 2 to 8
    #[arg(long, value_name = "N", default_value_t = Config::default().window, hide_short_help = true)]
    window: usize,
    /// Keyframes whose pictures are kept for stereo and refinement
    #[arg(long, value_name = "N", default_value_t = Config::default().kept, hide_short_help = true)]
    kept: usize,
    /// Gradient steps per keyframe, 0 to 5
    #[arg(long, value_name = "STEPS", default_value_t = Config::default().refine)]
    refine: usize,
    /// Seed of the sampling, and of the demo
    #[arg(long, default_value_t = 0, allow_negative_numbers = true)]
    seed: u64,
    /// Snapshot to write [default: the map's name with .snapshot]
    #[arg(long, value_name = "FILE")]
    snapshot: Option<PathBuf>,
    /// Keyframes from one snapshot to the next
    #[arg(long, value_name = "N", value_parser = positive, default_value_t = 20)]
    snapshot_every: usize,
    /// Go on from a snapshot, with its settings, after the frames that it has seen
    #[arg(long, value_name = "FILE")]
    resume: Option<PathBuf>,
    /// Write a line of JSON per keyframe: latency, Gaussians, bytes, PSNR before and after
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// Measure the map on all frames at the end, those that were mapped and those between apart
    #[arg(long)]
    evaluate: bool,
    /// Reconstruct the keyframes at once with the same number of Gaussians, to compare with; needs --evaluate
    #[arg(long, requires = "evaluate")]
    batch: bool,
    /// Write pictures of the map beside the frames, for every so many-th frame, with --evaluate
    #[arg(long, value_name = "DIR", requires = "evaluate", hide_short_help = true)]
    pictures: Option<PathBuf>,
    /// Plot Gaussians, memory and latency over the frames (SVG)
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    lpips: LpipsWeights,
}

/// Source of depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum DepthName {
    /// Measured depth that comes with the frames
    Measured,
    /// Plane-sweep stereo of keyframes
    Stereo,
}

/// What `--json` writes.
#[derive(Serialize)]
struct Record<'a> {
    recipe: Recipe<Config>,
    input: String,
    /// Of the first frame.
    size: [usize; 2],
    /// How many frames came before this run; above 0 only after --resume.
    first_frame: usize,
    frames: usize,
    keyframes: usize,
    waiting: usize,
    refused: usize,
    bad: usize,
    gaussians: usize,
    bytes: usize,
    largest_bytes: usize,
    latency: Latency,
    measured: Option<&'a Measured>,
    interrupted: bool,
    /// Why the stream ended before its end.
    broken: Option<&'a str>,
    peak_rss_bytes: Option<u64>,
}

/// Seconds per frame.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(crate) struct Latency {
    pub(crate) keyframe_median: f64,
    keyframe_worst: f64,
    other_median: f64,
    other_worst: f64,
}

/// A line of the log.
#[derive(Serialize)]
struct Line<'a> {
    frame: usize,
    name: &'a str,
    seconds: f64,
    gaussians: usize,
    bytes: usize,
    psnr_after: f64,
    rss_bytes: Option<u64>,
    #[serde(flatten)]
    keyframe: Integrated,
}

/// Whether Ctrl-C was pressed, or the process was asked to end: the stream then ends after the frame in work. The second time ends the process.
fn hear_interrupts() -> Outcome<Arc<AtomicBool>> {
    let interrupted = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        // In this order: the first signal finds the flag down.
        flag::register_conditional_shutdown(signal, 128 + signal, Arc::clone(&interrupted)).or_work()?;
        flag::register(signal, Arc::clone(&interrupted)).or_work()?;
    }
    Ok(interrupted)
}

pub(crate) fn run(arguments: &Arguments, common: &Common) -> Outcome {
    let snapshot = snapshot_path(arguments);
    let log = arguments.log.as_ref();
    let outputs = Outputs::of(common)
        .with("--output", Some(&arguments.output))
        .with("--snapshot", snapshot.as_ref())
        .with("--log", log)
        .with("--plot", arguments.plot.as_ref())
        .check()?;
    let from_folder = arguments.input.as_deref().filter(|path| *path != Path::new("-"));
    outputs.spare(from_folder.into_iter().chain(arguments.lpips.paths()))?;
    if let Some(folder) = &arguments.pictures {
        output::check_folder(folder)?;
    }
    let format = output::scene_format(&arguments.output)?;
    let lpips = arguments.lpips.read()?;
    if arguments.resume.is_some() {
        const SETTINGS: [&str; 7] = ["cap", "max-bytes", "depth", "tau", "window", "kept", "refine"];
        common.given.refuse(&SETTINGS, "the settings are those of the snapshot")?;
    }
    let mut mapper = arguments.resume.as_deref().map(Mapper::resume).transpose().or_input()?;
    let skip = mapper.as_ref().map_or(0, Mapper::frames);
    let progress = Progress::new(1);
    let mut source = source(arguments, skip, common, &progress)?;
    let interrupts = hear_interrupts()?;

    let mut lines = log.map(|path| log_file(path)).transpose()?;
    let mut rows: Vec<Row> = Vec::new();
    let (mut bad, mut broken, mut unsaved) = (0, None, 0);
    let mut viewer = gs_raster::Rasterizer::cpu();
    let mut size = [0; 2];
    loop {
        if interrupts.load(Ordering::SeqCst) {
            break;
        }
        let frame = match source.next() {
            Next::Frame(frame) => frame,
            Next::Nothing => continue,
            Next::End => break,
            Next::Broken(reason) => {
                broken = Some(reason);
                break;
            }
            Next::Bad(reason) => {
                progress.warn(&format!("not used: {reason}"));
                bad += 1;
                if let Some(mapper) = &mut mapper {
                    mapper.skip();
                }
                continue;
            }
        };
        let mapper = match &mut mapper {
            Some(mapper) => mapper,
            none => {
                let mut begun = Mapper::new(config(arguments, frame.view.depth().is_some())).or_input()?;
                (0..bad).for_each(|_| begun.skip());
                none.insert(begun)
            }
        };
        let update = match mapper.push(&frame) {
            Ok(update) => update,
            // The map of the frames before is written all the same.
            Err(error) => {
                broken = Some(format!("frame {}: {:#}", frame.view.name(), anyhow::Error::from(error)));
                break;
            }
        };
        if rows.is_empty() {
            size = [frame.view.camera().width(), frame.view.camera().height()];
        }
        let name = frame.view.name();
        if let Of::Refused(refusal) = &update.outcome {
            progress.warn(&format!("not used: frame {name}: {refusal}"));
        }
        progress.say(says(&update, source.len()));
        let rss = measure::rss_bytes();
        if let Of::Keyframe(keyframe) = update.outcome {
            if let Some(lines) = &mut lines {
                let psnr_after = measure::psnr(mapper.map(), &frame.view, &mut viewer)?;
                let line = Line {
                    frame: update.frame,
                    name,
                    seconds: update.seconds,
                    gaussians: update.gaussians,
                    bytes: update.bytes,
                    psnr_after,
                    rss_bytes: rss,
                    keyframe,
                };
                let text = serde_json::to_string(&line).or_work()?;
                writeln!(lines, "{text}").and_then(|()| lines.flush()).or_work()?;
            }
            unsaved += 1;
        }
        rows.push(Row::new(&update, rss));
        if let (Some(path), true) = (&snapshot, unsaved >= arguments.snapshot_every) {
            mapper.snapshot().write(path).or_work()?;
            unsaved = 0;
        }
    }
    let interrupted = interrupts.load(Ordering::SeqCst);
    let Some(mapper) = mapper else {
        let reason = broken.unwrap_or_else(|| "there were no frames".to_owned());
        return Err(Failure::input(format!("{}: {reason}", place(arguments))));
    };
    if let Some(path) = &snapshot {
        mapper.snapshot().write(path).or_work()?;
    }
    output::write_scene(&arguments.output, format, mapper.map(), |loss| progress.warn(loss))?;
    if let Some(path) = &arguments.plot {
        output::write_text(path, &plot::plot(&rows, mapper.config().cap))?;
    }
    let measured = if arguments.evaluate && !interrupted {
        let asked = measure::Asked {
            batch: arguments.batch,
            pictures: arguments.pictures.as_deref(),
            lpips: lpips.as_ref(),
        };
        Some(measure::measure(&source, &mapper, &rows, &asked, &progress)?)
    } else {
        None
    };
    drop(progress);
    let ended = Ended { size, first_frame: skip, bad, interrupted, broken: broken.as_deref() };
    finish(arguments, common, &mapper, &rows, &ended, measured.as_ref())?;
    match broken {
        Some(reason) => Err(Failure::work(format!("{reason}; the map of the frames before is written"))),
        None => Ok(()),
    }
}

/// How a stream ended, and what is known beside its frames.
struct Ended<'a> {
    size: [usize; 2],
    first_frame: usize,
    bad: usize,
    interrupted: bool,
    broken: Option<&'a str>,
}

/// Says what came of it, and writes the record.
fn finish(
    arguments: &Arguments,
    common: &Common,
    mapper: &Mapper,
    rows: &[Row],
    ended: &Ended<'_>,
    measured: Option<&Measured>,
) -> Outcome {
    let &Ended { size, first_frame, bad, interrupted, broken } = ended;
    let frames = |is: fn(&Row) -> bool| rows.iter().filter(|row| is(row)).count();
    let (waiting, refused) = (frames(|row| row.is_waiting), frames(|row| row.is_refused));
    let latency = measure::latency(rows);
    let peak = peak_rss_bytes();
    print_line(&format!(
        "frames     {}: {} keyframes, {} refused, {} not readable{}",
        rows.len() + bad,
        mapper.keyframes(),
        refused,
        bad,
        if waiting > 0 { format!(", {waiting} without stereo depth") } else { String::new() }
    ));
    print_line(&format!(
        "Gaussians  {} of at most {}, {:.1} MB",
        count(mapper.map().len() as f64),
        count(mapper.config().cap as f64),
        mapper.bytes() as f64 / 1e6
    ));
    print_line(&format!(
        "latency    keyframes {:.3} s (worst {:.3}), others {:.4} s (worst {:.4})",
        latency.keyframe_median, latency.keyframe_worst, latency.other_median, latency.other_worst
    ));
    for line in measured.iter().flat_map(|measured| measured.lines()) {
        print_line(&line);
    }
    print_line(&memory_line(peak));
    print_line(&format!("map        {}", named(&arguments.output)));
    if let Some(path) = snapshot_path(arguments) {
        print_line(&format!("snapshot   {}", named(&path)));
    }
    if interrupted {
        let on = if snapshot_path(arguments).is_some() { "; --resume goes on from the snapshot" } else { "" };
        print_line(&format!("stopped    by a signal{on}"));
    }
    let Some(path) = &common.json else { return Ok(()) };
    let record = Record {
        recipe: crate::recipe(mapper.config().seed, *mapper.config()),
        input: place(arguments),
        size,
        first_frame,
        frames: rows.len() + bad,
        keyframes: mapper.keyframes(),
        waiting,
        refused,
        bad,
        gaussians: mapper.map().len(),
        bytes: mapper.bytes(),
        largest_bytes: rows.iter().map(|row| row.bytes).max().unwrap_or(0),
        latency,
        measured,
        interrupted,
        broken,
        peak_rss_bytes: peak,
    };
    output::write_json(path, &record)
}

/// What the frames are called.
fn place(arguments: &Arguments) -> String {
    match &arguments.input {
        None => format!("simulated dwelling {}", arguments.seed),
        Some(path) if path == Path::new("-") => "standard input".to_owned(),
        Some(path) => path.display().to_string(),
    }
}

/// Where snapshots go; nowhere if the map goes to standard output or a device, and no file is named.
fn snapshot_path(arguments: &Arguments) -> Option<PathBuf> {
    let beside = || {
        output::is_file(&arguments.output).then(|| {
            let name = arguments.output.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let stem = name.split('.').next().filter(|stem| !stem.is_empty()).unwrap_or("map").to_owned();
            arguments.output.with_file_name(stem + ".snapshot")
        })
    };
    arguments.snapshot.clone().or_else(beside)
}

fn source(arguments: &Arguments, skip: usize, common: &Common, progress: &Progress) -> Outcome<Source> {
    let size = arguments.size;
    let Some(input) = &arguments.input else {
        return Source::simulated(arguments.seed, size, arguments.frames, skip);
    };
    let received = input == Path::new("-") || arguments.watch;
    if received {
        const OF_FILES: [&str; 6] = ["size", "frames", "evaluate", "format", "batch", "pictures"];
        common
            .given
            .refuse(&OF_FILES, "frames that are received are taken as they come, and are gone afterwards")?;
    }
    if arguments.watch {
        return Source::watched(input, arguments.idle.map(|s| Duration::from_secs(s as u64)), skip);
    }
    if received {
        return Ok(Source::standard_input());
    }
    let dataset = view_data::open(input, arguments.format).or_input()?;
    for dropped in dataset.dropped.iter().take(5) {
        progress.warn(&format!("not used: {}: {}", dropped.key, dropped.reason));
    }
    if let Some(offset) = dataset.offset {
        progress.warn(&format!("lies far from the origin: {offset} was subtracted from all positions"));
    }
    Source::dataset(dataset, size, arguments.frames.unwrap_or(usize::MAX), skip)
}

fn config(arguments: &Arguments, has_depth: bool) -> Config {
    let depth = match (arguments.depth, has_depth) {
        (Some(DepthName::Measured), _) | (None, true) => Depth::Measured,
        (Some(DepthName::Stereo), _) | (None, false) => Depth::Stereo,
    };
    Config {
        cap: arguments.cap,
        bytes: arguments.max_bytes,
        depth,
        tau: arguments.tau,
        window: arguments.window,
        kept: arguments.kept,
        refine: arguments.refine,
        seed: arguments.seed,
    }
}

/// The log, to be written line by line: who follows it sees each keyframe.
fn log_file(path: &Path) -> Outcome<Box<dyn Write>> {
    if output::is_file(path) {
        let file = File::create(path)
            .map_err(|error| Failure::work(format!("{}: cannot write: {error}", path.display())))?;
        return Ok(Box::new(file));
    }
    if named(path) == "standard output" {
        return Ok(Box::new(io::stdout()));
    }
    let device = File::options().write(true).open(path);
    Ok(Box::new(device.map_err(|error| Failure::work(format!("{}: cannot write: {error}", path.display())))?))
}

/// What a frame did, for people.
fn says(update: &Update, all: Option<usize>) -> String {
    let total = all.map_or_else(String::new, |all| format!(" of {all}"));
    let what = match &update.outcome {
        Of::Keyframe(keyframe) => format!("keyframe, {} drawn", keyframe.drawn),
        Of::Seen(_) => "seen".to_owned(),
        Of::Waiting(_) => "waiting for parallax".to_owned(),
        Of::Refused(_) => "refused".to_owned(),
    };
    format!("frame {}{total}: {what}; {} Gaussians", update.frame + 1, count(update.gaussians as f64))
}
