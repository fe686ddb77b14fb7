//! Replica as NICE-SLAM lays it out.

use super::{FrameToWrite, WriteRule, broken, picture, write_file};
use crate::{Error, PictureFormat, Result};
use gs_scene::{Intrinsics, Lens};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Counts of depth per metre.
const DEPTH_SCALE: f64 = 6553.5;

/// The frames so far.
#[derive(Debug, Default)]
pub(super) struct Trajectory {
    lens: Option<Lens>,
    /// `traj.txt`: a line per frame, the 16 numbers of its camera-to-world matrix, OpenCV axes, row by row.
    lines: String,
}

impl Trajectory {
    pub(super) fn add(&mut self, frame: &FrameToWrite<'_>) -> Result<u64> {
        let name = || frame.view.name().to_owned();
        if !frame.lens.model.is_pinhole() {
            return Err(broken(frame.target, WriteRule::Distorted { frame: name() }));
        }
        match &self.lens {
            None => {
                agrees_with(frame.lens, frame.target)?;
                self.lens = Some(*frame.lens);
            }
            Some(lens) if lens != frame.lens => {
                return Err(broken(frame.target, WriteRule::OtherLens { frame: name() }));
            }
            Some(_) => {}
        }
        let results = frame.folder.join("results");
        let file =
            |kind: &str, extension: &str| results.join(format!("{kind}{:06}.{extension}", frame.index));
        picture::write(frame.view.image(), &file("frame", "jpg"), PictureFormat::Jpeg)?;
        let lost = match frame.view.depth() {
            Some(depth) => picture::write_depth(depth, &file("depth", "png"), DEPTH_SCALE)?,
            None => 0,
        };
        let (axes, position) = (frame.view.camera().rotation().transpose(), frame.view.camera().position());
        let mut words: Vec<String> = Vec::with_capacity(16);
        for i in 0..3 {
            words.extend(
                [axes.x_axis[i], axes.y_axis[i], axes.z_axis[i], position[i]].map(|v| format!("{v:e}")),
            );
        }
        writeln!(self.lines, "{} 0e0 0e0 0e0 1e0", words.join(" ")).expect("a String takes all");
        Ok(lost)
    }

    pub(super) fn finish(&self, folder: &Path, target: &Path) -> Result<()> {
        write_file(&folder.join("traj.txt"), self.lines.as_bytes())?;
        let lens = self.lens.as_ref().expect("a data set without frames is not finished");
        let text = format!("{:#}", camera_json(lens));
        write_file(&camera_file(target), text.as_bytes())
    }
}

/// `cam_params.json` stands beside the scenes that share it.
fn camera_file(target: &Path) -> PathBuf {
    target.with_file_name("cam_params.json")
}

/// Centres of pixels are at whole numbers in this layout, at +0.5 in ours.
fn camera_json(lens: &Lens) -> Value {
    let Intrinsics { fx, fy, cx, cy, width, height } = lens.intrinsics;
    let (cx, cy) = (cx - 0.5, cy - 0.5);
    json!({ "camera": { "w": width, "h": height, "fx": fx, "fy": fy, "cx": cx, "cy": cy, "scale": DEPTH_SCALE } })
}

/// Scenes that are there already must have been taken with the same camera.
fn agrees_with(lens: &Lens, target: &Path) -> Result<()> {
    let path = camera_file(target);
    let text = match std::fs::read(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(source) => return Err(Error::Read { path, source }),
    };
    match serde_json::from_slice::<Value>(&text) {
        Ok(value) if value == camera_json(lens) => Ok(()),
        Ok(_) => Err(broken(&path, WriteRule::OtherCamera)),
        Err(source) => Err(Error::Json { path, source }),
    }
}
