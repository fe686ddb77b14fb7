//! nerfstudio's `transforms.json`.

use super::{FrameToWrite, PosedFrame, samples, write_file};
use crate::{DepthPercentiles, Result, ScenePoint, exr_depth};
use glam::DVec3;
use gs_scene::{Camera, Lens};
use serde_json::{Map, Value, json};
use std::path::Path;

/// The frames so far.
#[derive(Debug, Default)]
pub(super) struct Transforms {
    frames: Vec<(Lens, Map<String, Value>)>,
    /// Depths of samples of all frames.
    depths: Vec<f32>,
}

impl Transforms {
    pub(super) fn add(&mut self, frame: &FrameToWrite<'_>) -> Result<u64> {
        let mut entry = entry(frame.view.camera(), frame.write_picture()?);
        if let Some(map) = frame.view.depth() {
            let path = format!("depth/{}.exr", frame.view.name());
            exr_depth::write(map, &frame.folder.join(&path))?;
            entry.insert("depth_file_path".into(), path.into());
            self.depths
                .extend(samples::samples(frame.view, frame.lens).map(|(_, sample)| sample.depth as f32));
        }
        self.frames.push((*frame.lens, entry));
        Ok(0)
    }

    /// Frames whose pictures lie there already, without depth of their own.
    pub(super) fn of_posed(frames: &[PosedFrame], points: &[ScenePoint]) -> Self {
        let seen = |point: &ScenePoint| {
            let position = point.position;
            let depth = move |frame: usize| frames[frame].camera.to_camera(position).z as f32;
            point.observations.iter().map(|seen| depth(seen.frame)).collect::<Vec<_>>()
        };
        let path = |frame: &PosedFrame| format!("images/{}", frame.picture);
        Self {
            frames: frames.iter().map(|frame| (frame.lens, entry(&frame.camera, path(frame)))).collect(),
            depths: points.iter().flat_map(seen).collect(),
        }
    }

    pub(super) fn finish(&self, folder: &Path) -> Result<()> {
        let mut file = Map::new();
        let common = self.frames[0].0;
        let one_lens = self.frames.iter().all(|(lens, _)| *lens == common);
        if one_lens {
            file.extend(lens_keys(&common));
        }
        if self.frames.iter().any(|(_, entry)| entry.contains_key("depth_file_path")) {
            // EXR files hold scene units.
            file.insert("depth_unit_scale_factor".into(), 1.0.into());
        }
        if let Some(DepthPercentiles { p0_5, p2, p50, p98, p99_5 }) =
            DepthPercentiles::of(&mut self.depths.clone())
        {
            let percentiles = json!({ "0.5": p0_5, "2": p2, "50": p50, "98": p98, "99.5": p99_5 });
            file.insert("scene_depth_percentiles".into(), percentiles);
        }
        let frame = |(lens, entry): &(Lens, Map<String, Value>)| {
            let mut entry = entry.clone();
            if !one_lens {
                entry.extend(lens_keys(lens));
            }
            Value::Object(entry)
        };
        file.insert("frames".into(), self.frames.iter().map(frame).collect());
        let text = format!("{:#}", Value::Object(file));
        write_file(&folder.join("transforms.json"), text.as_bytes())
    }
}

/// Picture and pose of a frame.
fn entry(camera: &Camera, file_path: String) -> Map<String, Value> {
    // OpenGL's axes: y up, z backward.
    let axes = camera.rotation().transpose() * glam::DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let position = camera.position();
    let row = |i: usize| json!([axes.x_axis[i], axes.y_axis[i], axes.z_axis[i], position[i]]);
    let mut entry = Map::new();
    entry.insert("file_path".into(), file_path.into());
    entry.insert("transform_matrix".into(), json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]));
    entry
}

fn lens_keys(lens: &Lens) -> Map<String, Value> {
    let (i, d) = (&lens.intrinsics, lens.model.radial_tangential().expect("other models were refused"));
    let Value::Object(mut keys) = json!({
        "camera_model": if d.is_zero() { "PINHOLE" } else { "OPENCV" },
        "w": i.width, "h": i.height, "fl_x": i.fx, "fl_y": i.fy, "cx": i.cx, "cy": i.cy,
    }) else {
        unreachable!("an object was written down")
    };
    if !d.is_zero() {
        for (key, value) in [("k1", d.k1), ("k2", d.k2), ("k3", d.k3), ("p1", d.p1), ("p2", d.p2)] {
            keys.insert(key.into(), value.into());
        }
    }
    keys
}
