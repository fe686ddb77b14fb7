//! A tiny simulated data set in nerfstudio's layout, and calls of the binary.

use glam::{DMat3, DVec3};
use gs_scene::{Camera, View};
use report_parts::Picture;
use scene_windows::{SimulatedScene, Window, simulated_window};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use tempfile::TempDir;

/// Size of the photographs, pixels.
pub(crate) const SIZE: (usize, usize) = (120, 80);

/// Near and far of the simulated scene, metres: stated, so that tests do not hang on estimating it.
pub(crate) const RANGE: &str = "2,20";

/// What a call of the binary gave.
pub(crate) struct Called {
    pub(crate) code: Option<i32>,
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

/// Calls the binary.
pub(crate) fn call<I: AsRef<std::ffi::OsStr>>(arguments: &[I]) -> Called {
    let output = Command::new(env!("CARGO_BIN_EXE_sparsesplat")).args(arguments).output().unwrap();
    Called {
        code: output.status.code(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

impl Called {
    /// The output of a call that must have worked.
    pub(crate) fn succeeded(self) -> Self {
        assert_eq!(self.code, Some(0), "{}{}", self.stdout, self.stderr);
        self
    }
}

/// The photographs, simulated once for all tests.
pub(crate) fn window() -> &'static Window {
    static WINDOW: OnceLock<Window> = OnceLock::new();
    WINDOW.get_or_init(|| simulated_window(SimulatedScene::Courtyard, SIZE).unwrap())
}

/// A data set in a temporary folder `tiny`.
pub(crate) struct Tiny {
    folder: TempDir,
}

impl Tiny {
    /// Eleven frames along the path, and an index with one window.
    pub(crate) fn new() -> Self {
        let tiny = Self { folder: tempfile::tempdir().unwrap() };
        let window = window();
        let mut frames: Vec<(usize, &View)> =
            window.context_positions.iter().copied().zip(&window.context).collect();
        frames.extend(window.target_positions.iter().copied().zip(&window.targets));
        frames.sort_by_key(|(position, _)| *position);
        let views: Vec<&View> = frames.into_iter().map(|(_, view)| view).collect();
        for view in &views {
            let file = tiny.path(&format!("images/{}.png", view.name()));
            Picture::of_image(view.image()).save(&file).unwrap();
        }
        tiny.write("transforms.json", &transforms(&views));
        let index =
            json!({ "tiny/0": { "context": window.context_positions, "target": window.target_positions } });
        tiny.write("evaluation_index.json", &index);
        tiny
    }

    /// The data set's folder.
    pub(crate) fn root(&self) -> PathBuf {
        self.folder.path().join("tiny")
    }

    /// A file of the data set.
    pub(crate) fn path(&self, file: &str) -> PathBuf {
        self.root().join(file)
    }

    /// A file beside the data set.
    pub(crate) fn beside(&self, file: &str) -> PathBuf {
        self.folder.path().join(file)
    }

    fn write(&self, file: &str, value: &Value) {
        fs::write(self.path(file), value.to_string()).unwrap();
    }

    /// Changes transforms.json.
    pub(crate) fn edit(&self, change: impl FnOnce(&mut Value)) {
        let mut value = read_json(&self.path("transforms.json"));
        change(&mut value);
        self.write("transforms.json", &value);
    }

    /// Arguments of a reconstruction from six views into `scene.ply` beside the data set, and more.
    pub(crate) fn reconstruct(&self, more: &[&str]) -> Called {
        let (root, scene) = (self.root(), self.beside("scene.ply"));
        let mut arguments = vec!["reconstruct", root.to_str().unwrap(), "-o", scene.to_str().unwrap()];
        arguments.extend(more);
        call(&arguments)
    }
}

pub(crate) fn read_json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

fn transforms(views: &[&View]) -> Value {
    let lens = views[0].camera().intrinsics();
    let frames: Vec<Value> = views
        .iter()
        .map(|view| {
            json!({
                "file_path": format!("images/{}.png", view.name()),
                "transform_matrix": camera_to_world(view.camera()),
            })
        })
        .collect();
    json!({
        "camera_model": "PINHOLE", "fl_x": lens.fx, "fl_y": lens.fy, "cx": lens.cx, "cy": lens.cy,
        "w": lens.width, "h": lens.height,
        "scene_depth_percentiles": { "0.5": 2.2, "2": 2.5, "50": 5.0, "98": 12.0, "99.5": 16.0 },
        "frames": frames,
    })
}

/// The pose as nerfstudio writes it: OpenGL axes (x right, y up, z backward).
fn camera_to_world(camera: &Camera) -> Vec<Vec<f64>> {
    let axes = camera.rotation().transpose() * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let position = camera.position();
    let mut rows: Vec<Vec<f64>> =
        (0..3).map(|i| vec![axes.col(0)[i], axes.col(1)[i], axes.col(2)[i], position[i]]).collect();
    rows.push(vec![0.0, 0.0, 0.0, 1.0]);
    rows
}
