//! From photographs or a video to a posed data set.

use crate::colmap::{Colmap, INSTALL, Mapper};
use crate::engine::{Engine, Solution, Step, Task};
use crate::error::MINIMUM;
use crate::level::{Levelling, level};
use crate::photographs::{Listed, MOST, chain, list_photographs, prepare_photographs};
use crate::pinhole::undistort;
use crate::verdict::{Doubt, Verdict, judge, write_data_set};
use crate::video::{Cut, frames, is_video};
use crate::{CameraGroup, Error, Photographs, Result};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use view_data::{Dropped, Staging};

/// Which engine is asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum EngineChoice {
    /// openMVG-rs; where its result is doubtful, COLMAP too if it is there. The better result is taken.
    #[default]
    Auto,
    /// openMVG-rs.
    OpenMvg,
    /// COLMAP, photograph by photograph.
    Colmap,
    /// COLMAP's global mapper, which version 4 has.
    ColmapGlobal,
}

/// How poses are estimated.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Settings {
    /// Which engine is asked.
    pub engine: EngineChoice,
    /// Of a video, what is taken.
    pub cut: Cut,
    /// Keep blurred photographs and copies.
    pub keep_all: bool,
    /// Take the distortion of the lens out of the photographs: pinholes are written. Otherwise they stay as they are, and the lens is written
    /// with its distortion.
    pub undistort: bool,
    /// Seed of random draws.
    pub seed: u64,
}

/// What was estimated; also the content of `poses.json` in the folder of the data set.
#[derive(Debug, Clone, Serialize)]
pub struct Estimate {
    /// What it was made from.
    pub source: Source,
    /// How.
    pub settings: Settings,
    /// The engine whose result was taken.
    pub engine: &'static str,
    /// What was measured of the result.
    pub verdict: Verdict,
    /// Every attempt, in order.
    pub attempts: Vec<Attempt>,
    /// What to do about the doubts, if there are some.
    pub advice: Option<String>,
    /// The cameras.
    pub cameras: Vec<CameraGroup>,
    /// Photographs that were turned as EXIF says.
    pub turned: usize,
    /// Photographs that are not used, and why.
    pub not_used: Vec<NotUsed>,
    /// Pictures in formats that are not read.
    pub other_formats: usize,
    /// What the engine's world was turned, moved and scaled by.
    pub levelling: Levelling,
}

/// What poses were estimated from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// Folder or video, as it was given.
    pub input: String,
    /// Pictures, or 1 for a video.
    pub files: usize,
    /// Their bytes together.
    pub bytes: u64,
}

/// An attempt of an engine.
#[derive(Debug, Clone, Serialize)]
pub struct Attempt {
    /// The engine.
    pub engine: &'static str,
    /// What was measured of its result.
    pub verdict: Option<Verdict>,
    /// Why it has none.
    pub failed: Option<String>,
}

/// A photograph that is not used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct NotUsed {
    /// File name.
    pub photograph: String,
    /// Why.
    pub reason: String,
}

/// Name of the file that says how the poses were estimated.
pub const RECORD: &str = "poses.json";

/// Estimates the poses of the photographs in a folder, or of frames of a video, and writes a data set into the folder `target`, which must
/// not exist, or be empty: `images/` with the photographs that have a pose, `transforms.json`, `sparse/0/` and `poses.json`.
///
/// `on_step` is called from several threads.
///
/// # Errors
/// If there are no photographs, none overlap, or the poses certainly serve for nothing. Doubts that leave a result are in
/// [`Estimate::verdict`].
pub fn estimate_poses(
    input: &Path,
    target: &Path,
    settings: &Settings,
    on_step: &(dyn Fn(Step) + Sync),
) -> Result<Estimate> {
    let engines = engines(settings.engine)?;
    let video = is_video(input);
    let found = std::fs::metadata(input).map_err(|source| Error::File {
        action: "read",
        path: input.into(),
        source,
    })?;
    if !video && !found.is_dir() {
        return Err(Error::NoInput { path: input.to_path_buf() });
    }
    let Listed { files, other_formats } = files_of(input)?;
    let source = source(input, &files)?;
    let staging = Staging::create(target)?;
    let (images, work) = (staging.folder().join("images"), staging.folder().join("work"));
    let file = |action, path: &Path| {
        let path = path.to_path_buf();
        move |source| Error::File { action, path, source }
    };
    std::fs::create_dir_all(&work).map_err(file("make the folder", &work))?;
    let files = if video {
        let wanted = settings.cut.frames;
        if wanted > MOST {
            return Err(Error::TooMany { path: input.to_path_buf(), found: wanted, limit: MOST });
        }
        frames(input, settings.cut, &work.join("frames"), on_step)?
    } else {
        files
    };
    let read = |done, total| on_step(Step::Read(done, total));
    let prepared = prepare_photographs(input, &files, &images, settings.keep_all, &read);
    let prepared = prepared.map_err(|error| match error {
        Error::TooFew { found, usable, .. } if video && found >= MINIMUM => {
            Error::StandsStill { path: input.to_path_buf(), frames: found, different: usable }
        }
        error => error,
    })?;

    let task = Task {
        images: &images,
        photographs: &prepared.photographs,
        cameras: &prepared.cameras,
        sequence: video,
        seed: settings.seed,
        work: &work,
    };
    let (mut best, attempts) = best_of(&engines, &task, staging.folder(), on_step)?;
    let advice = (!best.verdict.doubts.is_empty()).then(|| advice(&attempts, &best.verdict.doubts));
    if best.verdict.is_fatal() {
        let doubts = best.verdict.doubts.iter().map(ToString::to_string).collect();
        return Err(Error::Lost {
            engine: best.engine.to_owned(),
            doubts,
            advice: advice.unwrap_or_default(),
        });
    }
    write_data_set(&best.solution, &task, staging.folder())?;
    let not_used = not_used(&prepared, &best.solution);
    for left_out in &not_used {
        // Those that could not be read never got there.
        let _ = std::fs::remove_file(images.join(&left_out.photograph));
    }
    if settings.undistort {
        on_step(Step::Undistort);
        undistort(&mut best.solution, &task, staging.folder())?;
        write_data_set(&best.solution, &task, staging.folder())?;
    }
    std::fs::remove_dir_all(&work).map_err(file("remove", &work))?;
    let estimate = Estimate {
        source,
        settings: *settings,
        engine: best.engine,
        verdict: best.verdict,
        attempts,
        advice,
        turned: prepared.photographs.iter().filter(|photograph| photograph.turned).count(),
        cameras: prepared.cameras,
        not_used,
        other_formats,
        levelling: best.levelling,
    };
    let record = staging.folder().join(RECORD);
    let text =
        serde_json::to_string_pretty(&estimate).map_err(|error| std::io::Error::other(error.to_string()));
    text.and_then(|text| std::fs::write(&record, text)).map_err(file("write", &record))?;
    staging.finish()?;
    Ok(estimate)
}

/// Whether a folder holds what [`estimate_poses`] would make of this input with these settings, so that it need not be made again.
#[must_use]
pub fn is_made_from(folder: &Path, input: &Path, settings: &Settings) -> bool {
    let record = || {
        let text = std::fs::read(folder.join(RECORD)).ok()?;
        let record: serde_json::Value = serde_json::from_slice(&text).ok()?;
        let Listed { files, .. } = files_of(input).ok()?;
        let same_source = Source::deserialize(&record["source"]).ok()? == source(input, &files).ok()?;
        Some(same_source && record["settings"] == serde_json::to_value(settings).ok()?)
    };
    folder.join("transforms.json").is_file() && record().unwrap_or(false)
}

/// A video, or the photographs of a folder.
fn files_of(input: &Path) -> Result<Listed> {
    if is_video(input) {
        return Ok(Listed { files: vec![input.to_path_buf()], other_formats: 0 });
    }
    list_photographs(input)
}

fn source(input: &Path, files: &[PathBuf]) -> Result<Source> {
    let mut bytes = 0;
    for file in files {
        let found = std::fs::metadata(file);
        bytes += found.map_err(|source| Error::File { action: "read", path: file.clone(), source })?.len();
    }
    Ok(Source { input: input.display().to_string(), files: files.len(), bytes })
}

/// The engines to ask.
fn engines(choice: EngineChoice) -> Result<Vec<Box<dyn Engine>>> {
    let mut engines: Vec<Box<dyn Engine>> = Vec::new();
    if matches!(choice, EngineChoice::Auto | EngineChoice::OpenMvg) {
        #[cfg(feature = "openmvg")]
        engines.push(Box::new(crate::OpenMvg));
        #[cfg(not(feature = "openmvg"))]
        if choice == EngineChoice::OpenMvg || !Colmap::is_there() {
            return Err(Error::NotBuilt);
        }
    }
    let colmap = |mapper| Box::new(Colmap::new(mapper));
    match choice {
        EngineChoice::Colmap => engines.push(colmap(Mapper::Incremental)),
        EngineChoice::ColmapGlobal => engines.push(colmap(Mapper::Global)),
        EngineChoice::Auto if Colmap::is_there() => {
            engines.push(colmap(Mapper::Incremental));
            engines.push(colmap(Mapper::Global));
        }
        EngineChoice::Auto | EngineChoice::OpenMvg => {}
    }
    Ok(engines)
}

/// A result.
struct Candidate {
    engine: &'static str,
    solution: Solution,
    levelling: Levelling,
    verdict: Verdict,
}

/// How often photographs whose poses contradict the others' are left out: without them, more may stand out.
const LEAVE_OUT: usize = 3;

/// The first result without doubts, or else the best.
fn best_of(
    engines: &[Box<dyn Engine>],
    task: &Task<'_>,
    folder: &Path,
    on_step: &(dyn Fn(Step) + Sync),
) -> Result<(Candidate, Vec<Attempt>)> {
    let mut attempts = Vec::new();
    let mut best: Option<Candidate> = None;
    let mut failure = None;
    for engine in engines {
        let work = task.work.join(engine.name());
        std::fs::create_dir_all(&work).map_err(|source| Error::File {
            action: "make the folder",
            path: work.clone(),
            source,
        })?;
        // Of several, one that is not there is none.
        if engines.len() > 1 && !engine.can_be_asked(&work) {
            continue;
        }
        if !attempts.is_empty() {
            on_step(Step::Again(engine.name()));
        }
        let task = Task { work: &work, ..*task };
        let mut attempt = Attempt { engine: engine.name(), verdict: None, failed: None };
        match engine.estimate(&task, on_step) {
            Ok(solution) => {
                let solution = solution.without_nonsense(task.photographs);
                on_step(Step::Check);
                let mut candidate = judged(engine.name(), solution, &task, folder)?;
                for Attempt { engine, verdict, .. } in &attempts {
                    if let Some(verdict) = verdict {
                        candidate.verdict.dispute(engine, verdict, task.cameras);
                    }
                }
                attempt.verdict = Some(candidate.verdict.clone());
                if best.as_ref().is_none_or(|best| candidate.verdict.is_better_than(&best.verdict)) {
                    best = Some(candidate);
                }
            }
            Err(error) => {
                attempt.failed = Some(chain(&error));
                failure.get_or_insert(error);
            }
        }
        attempts.push(attempt);
        if best.as_ref().is_some_and(|best| best.verdict.doubts.is_empty()) {
            break;
        }
    }
    match (best, failure) {
        (Some(best), _) => Ok((best, attempts)),
        (None, Some(failure)) => Err(failure),
        (None, None) => Err(Error::NotBuilt),
    }
}

/// A solution without the photographs that contradict the others, levelled, and what is to be said of it.
fn judged(engine: &'static str, mut solution: Solution, task: &Task<'_>, folder: &Path) -> Result<Candidate> {
    let mut verdict = judge(&solution, task, folder)?;
    for _ in 0..LEAVE_OUT {
        let misfits = verdict.misfits(task, &solution);
        if misfits.is_empty() || verdict.registered < misfits.len() + MINIMUM {
            break;
        }
        solution.leave_out(&misfits, "its pose contradicts its matches with the others");
        verdict = judge(&solution, task, folder)?;
    }
    let levelling = level(&mut solution);
    Ok(Candidate { engine, solution, levelling, verdict })
}

/// What to do about doubts.
fn advice(attempts: &[Attempt], doubts: &[Doubt]) -> String {
    let turned = |doubt: &Doubt| matches!(doubt, Doubt::Turned { .. } | Doubt::Parallax { .. });
    if doubts.iter().any(turned) {
        return "take a step between photographs, do not only turn".to_owned();
    }
    let focal = |doubt: &Doubt| matches!(doubt, Doubt::FocalUncertain { .. } | Doubt::FocalDisputed { .. });
    if doubts.iter().all(focal) {
        return "turn the camera between photographs, or use photographs with EXIF data".to_owned();
    }
    let asked = |name| attempts.iter().any(|attempt| attempt.engine.starts_with(name));
    let more = "leave out what shows another scene or comes from another camera, take more photographs, from places nearer to each other";
    match (asked("openmvg"), asked("colmap")) {
        (true, false) if !Colmap::is_there() => {
            format!("{more}, or install COLMAP, which fails on other photographs ({INSTALL}), and run again")
        }
        (true, false) => format!("{more}, or try the engine colmap"),
        (false, true) => format!("{more}, or try the engine openmvg"),
        _ => more.to_owned(),
    }
}

fn not_used(prepared: &Photographs, solution: &Solution) -> Vec<NotUsed> {
    let entry =
        |Dropped { key, reason }: &Dropped| NotUsed { photograph: key.clone(), reason: reason.clone() };
    let mut all: Vec<NotUsed> = prepared.dropped.iter().map(entry).collect();
    for (index, photograph) in prepared.photographs.iter().enumerate() {
        if solution.poses[index].is_none() {
            let reason = solution.reasons[index].clone().unwrap_or_else(|| "not registered".to_owned());
            all.push(NotUsed { photograph: photograph.name.clone(), reason });
        }
    }
    all.sort_by(|a, b| a.photograph.cmp(&b.photograph));
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Photograph;
    use crate::engine::Pose;
    use glam::{DMat3, DVec3};
    use gs_scene::{Camera, Distortion, Lens};
    use image::RgbImage;
    use scene_sim::{Traced, demo_scene, lens, render_view};

    const SIZE: [usize; 2] = [240, 180];

    /// A camera of the courtyard on a path that bends.
    fn camera(i: usize) -> Camera {
        let t = i as f64;
        let angle = (-132.0 + 5.0 * t).to_radians();
        let radius = 4.3 + 0.3 * (1.9 * t).sin();
        let position =
            DVec3::new(0.4 + radius * angle.cos(), 0.9 + radius * angle.sin(), 1.7 + 0.25 * (1.3 * t).sin());
        Camera::looking_at(lens(SIZE[0], SIZE[1], 62.0), position, DVec3::new(0.4, 0.9, 0.95), DVec3::Z)
            .unwrap()
    }

    #[test]
    fn a_photograph_whose_pose_is_wrong_is_left_out_and_named_by_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let images = folder.path().join("images");
        std::fs::create_dir(&images).unwrap();
        let scene = Traced::new(&demo_scene()).unwrap();
        // Two files of one stem: their frames are not named by it.
        let name = |i: usize| if i == 4 { "view3.jpg".to_owned() } else { format!("view{i}.png") };
        let mut photographs = Vec::new();
        let mut poses = Vec::new();
        for i in 0..7 {
            let camera = camera(i);
            let view = render_view(&scene, &camera, 2, "view", 0).unwrap();
            let picture = RgbImage::from_raw(SIZE[0] as u32, SIZE[1] as u32, view.image().to_rgb8()).unwrap();
            picture.save(images.join(name(i))).unwrap();
            photographs.push(Photograph::of_size(&name(i), SIZE));
            // The fifth looks past what it shows.
            let turn = if i == 4 { DMat3::from_rotation_z(0.06) } else { DMat3::IDENTITY };
            poses
                .push(Some(Pose { axes: turn * camera.rotation().transpose(), position: camera.position() }));
        }
        let intrinsics = lens(SIZE[0], SIZE[1], 62.0);
        let solution = Solution {
            lenses: vec![Lens { intrinsics, model: Distortion::default().into() }],
            poses,
            reasons: vec![None; 7],
            points: Vec::new(),
        };
        let camera = CameraGroup {
            width: SIZE[0],
            height: SIZE[1],
            name: None,
            focal_mm: None,
            focal_pixels: Some(intrinsics.fx),
            photographs: 7,
        };
        let task = Task {
            images: &images,
            photographs: &photographs,
            cameras: &[camera],
            sequence: false,
            seed: 0,
            work: folder.path(),
        };
        let before = judge(&solution, &task, folder.path()).unwrap();
        assert_eq!(before.misfits(&task, &solution), [4], "{:?}", before.doubts);
        let Candidate { solution, verdict, .. } = judged("test", solution, &task, folder.path()).unwrap();
        assert_eq!(verdict.registered, 6);
        assert!(
            !verdict.doubts.iter().any(|doubt| matches!(doubt, Doubt::Misfits { .. })),
            "{:?}",
            verdict.doubts
        );
        assert!(solution.poses[4].is_none() && solution.poses[3].is_some());
        assert!(solution.reasons[4].as_ref().is_some_and(|reason| reason.contains("contradicts")));
    }
}
