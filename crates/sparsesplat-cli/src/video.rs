//! `render --path`: the frames of a camera path, and a video of them where ffmpeg is there.

use crate::failure::{Failure, OrFail, Outcome};
use crate::progress::Progress;
use crate::summary::warn;
use anyhow::Context;
use clap::ValueEnum;
use evaluate::{render_ellipsoids, render_view};
use gs_raster::Rasterizer;
use gs_scene::{Camera, Gaussians};
use report_parts::Picture;
use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Frames a second of the video.
pub(crate) const RATE: usize = 30;

/// How the camera moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum PathName {
    /// On a closed ellipse about the middle camera, looking at the scene's middle
    Orbit,
    /// Along the cameras, in their order
    Cameras,
}

impl PathName {
    /// The cameras of the path.
    pub(crate) fn cameras(
        self,
        cameras: &[Camera],
        gaussians: &Gaussians,
        frames: usize,
    ) -> Outcome<Vec<Camera>> {
        match self {
            Self::Orbit => viewer::around(cameras, gaussians, frames),
            Self::Cameras => viewer::along(cameras, frames),
        }
        .or_input()
    }
}

/// File of a frame.
pub(crate) fn frame_file(folder: &Path, frame: usize) -> PathBuf {
    folder.join(format!("frame-{frame:05}.png"))
}

/// File of the video.
pub(crate) fn video_file(folder: &Path) -> PathBuf {
    folder.join("path.mp4")
}

/// Renders and writes every frame; one is in memory at a time. Returns how many Gaussians cannot be drawn.
pub(crate) fn write_frames(
    rasterizer: &mut Rasterizer,
    gaussians: &Gaussians,
    cameras: &[Camera],
    ellipsoids: bool,
    folder: &Path,
) -> Outcome<usize> {
    let progress = Progress::new(cameras.len());
    let mut rejected = 0;
    for (i, camera) in cameras.iter().enumerate() {
        progress.say(format!("frame {i}"));
        let draw = if ellipsoids { render_ellipsoids } else { render_view };
        let view = draw(rasterizer, gaussians, camera).or_work()?;
        rejected = rejected.max(view.rejected);
        Picture::of_image(&view.image).save(&frame_file(folder, i)).or_work()?;
        progress.step();
    }
    Ok(rejected)
}

/// Makes a video of so many frames. Without ffmpeg there is none, and that is told.
pub(crate) fn encode(folder: &Path, frames: usize) -> Outcome<Option<PathBuf>> {
    const UNFINISHED: &str = ".path.mp4";
    let Some(ffmpeg) = ffmpeg() else {
        warn("no video: ffmpeg is not on the PATH; the frames are there as pictures");
        return Ok(None);
    };
    // In the folder, whose name may have a % that ffmpeg would take for a pattern. There may be more frames of an earlier run.
    let output = Command::new(&ffmpeg)
        .args([
            "-nostdin",
            "-loglevel",
            "error",
            "-y",
            "-framerate",
            &RATE.to_string(),
            "-i",
            "frame-%05d.png",
        ])
        .args(["-frames:v", &frames.to_string()])
        // Players want even sizes and this pixel format.
        .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-movflags", "+faststart"])
        .args(["-f", "mp4", UNFINISHED])
        .current_dir(folder)
        .stdin(Stdio::null())
        .output()
        .with_context(|| format!("{}: cannot be run", ffmpeg.display()))
        .or_work()?;
    let (path, unfinished) = (video_file(folder), folder.join(UNFINISHED));
    if !output.status.success() {
        // It may not have begun the file.
        let _ = std::fs::remove_file(&unfinished);
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(Failure::work(format!("{}: cannot make the video: {}", ffmpeg.display(), said.trim())));
    }
    std::fs::rename(&unfinished, &path).with_context(|| path.display().to_string()).or_work()?;
    Ok(Some(path))
}

/// The first ffmpeg on the PATH, by its absolute path.
fn ffmpeg() -> Option<PathBuf> {
    let name = format!("ffmpeg{}", env::consts::EXE_SUFFIX);
    let found =
        env::split_paths(&env::var_os("PATH")?).map(|folder| folder.join(&name)).find(|path| path.is_file());
    std::path::absolute(found?).ok()
}
