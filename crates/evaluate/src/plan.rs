//! Which windows there are, and how each is loaded.

use crate::simulated::{NAME, simulated_window};
use crate::{Dropped, Error, Result, Window};
use serde::Serialize;
use sparsesplat::DepthRange;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;
use view_data::{Dataset, SceneDepth, estimate_scene_depth, open_nerfstudio, read_index, select_views};

/// Names of the files that make a folder a scene with windows.
const TRANSFORMS: &str = "transforms.json";
const INDEX: &str = "evaluation_index.json";

/// A window that is known by name and not yet loaded.
#[derive(Debug, Clone)]
pub struct Plan {
    name: String,
    source: Source,
}

#[derive(Debug, Clone)]
enum Source {
    Simulated { size: (usize, usize) },
    Photographs(Photographs),
}

#[derive(Debug, Clone)]
struct Photographs {
    dataset: Arc<Dataset>,
    choice: Choice,
    size: Option<(usize, usize)>,
    hint: Option<DepthRange>,
}

/// Which frames of a data set are used for what: positions in its list.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Choice {
    /// Views to reconstruct from.
    pub context: Vec<usize>,
    /// Views to measure on.
    pub targets: Vec<usize>,
    /// Share of the frames that the context leaves uncovered, 0..1; known where the views were selected.
    pub uncovered: Option<f64>,
}

/// How photographs are read.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct Reading {
    /// Size to scale and crop to; as they lie on disk without.
    pub size: Option<(usize, usize)>,
    /// Take the depth range from the data set (`scene_depth_percentiles`).
    pub depth_hint: bool,
}

impl Plan {
    /// The simulated demonstration.
    #[must_use]
    pub fn simulated(size: (usize, usize)) -> Self {
        Self { name: NAME.to_owned(), source: Source::Simulated { size } }
    }

    /// A window over views of a nerfstudio folder chosen by their overlap; the targets are the frames between them.
    ///
    /// # Errors
    /// If the folder cannot be read, or has not that many connected views.
    pub fn selection(input: &Path, views: usize, reading: Reading) -> Result<Self> {
        let dataset = Arc::new(open_nerfstudio(input)?);
        // Frames whose pictures are missing keep their positions, but none of them is chosen.
        let present = dataset.present();
        if let Some(frame) =
            dataset.frames.iter().find(|frame| frame.image.is_missing() && views > present.len())
        {
            let (path, frame) = (frame.image.path().to_path_buf(), frame.name.clone());
            return Err(view_data::Error::MissingPicture { path, frame }.into());
        }
        let cameras: Vec<_> =
            present.iter().map(|&position| dataset.camera(position)).collect::<view_data::Result<_>>()?;
        let stated = dataset.depth_percentiles.filter(|_| reading.depth_hint).map(SceneDepth::from);
        let choice = match stated.or_else(|| estimate_scene_depth(&cameras)) {
            Some(depth) => {
                let selection = select_views(&cameras, views, depth)?;
                let uncovered = Some(selection.uncovered);
                let positions = |chosen: Vec<usize>| chosen.into_iter().map(|i| present[i]).collect();
                let (context, targets) = (positions(selection.context), positions(selection.targets));
                Choice { context, targets, uncovered }
            }
            // A single view needs no depth to be selected by.
            None if views == 1 && !present.is_empty() => {
                Choice { context: vec![present[0]], targets: Vec::new(), uncovered: None }
            }
            None => return Err(Error::OnePlace { path: dataset.file.clone(), frames: cameras.len(), views }),
        };
        Self::photographs(format!("{}/selection", dataset.name), dataset, choice, reading)
    }

    /// The windows of an index file (pixelSplat's layout, keys `scene/window`) for a nerfstudio folder, and the entries
    /// of that scene that have none. Targets that are context views too are no measure of new views and are left out.
    ///
    /// # Errors
    /// If a file cannot be read, or has no such window.
    pub fn windows(input: &Path, index: &Path, reading: Reading) -> Result<(Vec<Self>, Vec<Dropped>)> {
        let dataset = Arc::new(open_nerfstudio(input)?);
        let index = read_index(index)?;
        let plan = |window: &view_data::Window| {
            let held_out = |position: &usize| !window.context.contains(position);
            let choice = Choice {
                context: window.context.clone(),
                targets: window.target.iter().copied().filter(held_out).collect(),
                uncovered: None,
            };
            Self::photographs(window.key.clone(), Arc::clone(&dataset), choice, reading)
        };
        let plans = index.windows_of(&dataset)?.into_iter().map(plan).collect::<Result<_>>()?;
        let of_scene = |entry: &view_data::Dropped| scene_of(&entry.key) == dataset.name;
        let dropped = index.dropped.into_iter().filter(of_scene);
        Ok((plans, dropped.map(|entry| Dropped { name: entry.key, reason: entry.reason }).collect()))
    }

    /// The window called `key` of an index file.
    ///
    /// # Errors
    /// As [`Plan::windows`], or if there is no window of that name.
    pub fn window(input: &Path, index: &Path, key: &str, reading: Reading) -> Result<Self> {
        let (plans, _) = Self::windows(input, index, reading)?;
        let known = plans.iter().map(|plan| plan.name.as_str()).collect::<Vec<_>>().join(", ");
        plans.into_iter().find(|plan| plan.name == key).ok_or_else(|| Error::NoWindow {
            index: index.to_path_buf(),
            key: key.to_owned(),
            known,
        })
    }

    /// All windows below a folder: of the folder itself if it has a `transforms.json` (by its index, or a selection of
    /// `views` views without one), else of every sub-folder with `transforms.json` and `evaluation_index.json`, in the
    /// order of their names. A sub-folder that cannot be read is returned as dropped.
    ///
    /// # Errors
    /// If the folder itself cannot be read, or there is nothing to evaluate.
    pub fn below(root: &Path, views: usize, reading: Reading) -> Result<(Vec<Self>, Vec<Dropped>)> {
        if root.is_file() || root.join(TRANSFORMS).is_file() {
            let index = root.join(INDEX);
            return if index.is_file() {
                Self::windows(root, &index, reading)
            } else {
                Ok((vec![Self::selection(root, views, reading)?], Vec::new()))
            };
        }
        let list = |source| Error::List { root: root.to_path_buf(), source };
        let mut folders: Vec<PathBuf> = Vec::new();
        for entry in std::fs::read_dir(root).map_err(list)? {
            let folder = entry.map_err(list)?.path();
            if folder.join(TRANSFORMS).is_file() && folder.join(INDEX).is_file() {
                folders.push(folder);
            }
        }
        folders.sort();
        if folders.is_empty() {
            return Err(Error::NoScenes { root: root.to_path_buf() });
        }
        let (mut plans, mut dropped) = (Vec::new(), Vec::new());
        for folder in folders {
            match Self::windows(&folder, &folder.join(INDEX), reading) {
                Ok((windows, empty)) => {
                    plans.extend(windows);
                    dropped.extend(empty);
                }
                Err(error) => dropped.push(Dropped::new(&folder.display().to_string(), &error)),
            }
        }
        Ok((plans, dropped))
    }

    fn photographs(name: String, dataset: Arc<Dataset>, choice: Choice, reading: Reading) -> Result<Self> {
        let hint = match (reading.depth_hint, &dataset.depth_percentiles) {
            (false, _) => None,
            (true, Some(depths)) => Some(DepthRange::Known { near: depths.p0_5, far: depths.p99_5 }),
            (true, None) => return Err(Error::NoDepthHint { path: dataset.file.clone() }),
        };
        Ok(Self {
            name,
            source: Source::Photographs(Photographs { dataset, choice, size: reading.size, hint }),
        })
    }

    /// `scene/window`.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Which frames are used, where there is a list of frames.
    #[must_use]
    pub fn choice(&self) -> Option<&Choice> {
        match &self.source {
            Source::Simulated { .. } => None,
            Source::Photographs(photographs) => Some(&photographs.choice),
        }
    }

    /// The depth range to use: the data set's where the plan is to use it, else `asked`.
    #[must_use]
    pub fn depth_range(&self, asked: DepthRange) -> DepthRange {
        match &self.source {
            Source::Simulated { .. } => asked,
            Source::Photographs(photographs) => photographs.hint.unwrap_or(asked),
        }
    }

    /// Loads the views, the targets only if they are wanted.
    ///
    /// # Errors
    /// If a file is missing or wrong.
    pub fn load(&self, with_targets: bool) -> Result<Window> {
        let Photographs { dataset, choice, size, .. } = match &self.source {
            Source::Simulated { size } => return simulated_window(*size),
            Source::Photographs(photographs) => photographs,
        };
        let begin = Instant::now();
        let target_positions = if with_targets { choice.targets.clone() } else { Vec::new() };
        let positions: Vec<usize> = choice.context.iter().chain(&target_positions).copied().collect();
        let mut context = dataset.load_views(&positions, *size)?;
        let targets = context.split_off(choice.context.len());
        Ok(Window {
            name: self.name.clone(),
            context,
            targets,
            context_positions: choice.context.clone(),
            target_positions,
            load_seconds: begin.elapsed().as_secs_f64(),
        })
    }
}

/// The scene of a window's name: what stands before the last slash.
pub(crate) fn scene_of(name: &str) -> &str {
    name.rsplit_once('/').map_or(name, |(scene, _)| scene)
}
