//! The list of windows, and how each is loaded.

mod selection;

use crate::simulated::{SimulatedScene, description, simulated_window};
use crate::{Dropped, Error, Result, Window};
use gs_scene::Camera;
use serde::Serialize;
use sparsesplat::DepthRange;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::Instant;
use view_data::{
    Dataset, Format, SceneDepth, estimate_scene_depth, open_all, read_index, windows_along, windows_around,
};

/// A window that is known by name and not yet loaded.
#[derive(Debug, Clone)]
pub struct Plan {
    name: String,
    source: Source,
    /// Where the loaded window stays, if it is to.
    memory: Option<Arc<OnceLock<Window>>>,
}

#[derive(Debug, Clone)]
enum Source {
    Simulated { scene: SimulatedScene, size: (usize, usize) },
    Photographs(Photographs),
}

#[derive(Debug, Clone)]
struct Photographs {
    dataset: Arc<Dataset>,
    choice: Choice,
    size: Option<(usize, usize)>,
    hint: Option<DepthRange>,
    /// How many views were selected by their overlap; `None` where somebody named the frames.
    selected: Option<usize>,
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
    /// Layout of the files; recognised by what lies there without.
    pub format: Option<Format>,
    /// Size to scale and crop to; as they lie on disk without.
    pub size: Option<(usize, usize)>,
    /// Take the depth range from the data set: what it states, its points or its measured depth.
    pub depth_hint: bool,
}

/// Which windows of a scene are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Windows {
    /// Context views of a window.
    pub views: usize,
    /// Windows along the path of each scene. Without, one window over views chosen by their overlap, or [`ALONG_A_VIDEO`] windows
    /// where the frames are those of a video.
    pub along: Option<usize>,
    /// Take the windows of `evaluation_index.json` in the folder of a scene instead, where there is one.
    pub index: bool,
}

/// Windows of a video, unless another number is asked for.
pub const ALONG_A_VIDEO: usize = 3;
/// Name of the index file that is looked for in the folder of a scene.
const INDEX: &str = "evaluation_index.json";

impl Plan {
    /// A simulated scene.
    #[must_use]
    pub fn simulated(scene: SimulatedScene, size: (usize, usize)) -> Self {
        Self { name: format!("{scene}/0"), source: Source::Simulated { scene, size }, memory: None }
    }

    /// The window called `key` of an index file.
    ///
    /// # Errors
    /// If a file cannot be read, or there is no window of that name.
    pub fn window(input: &Path, index: &Path, key: &str, reading: Reading) -> Result<Self> {
        let (plans, dropped) = Self::of_index(input, index, reading)?;
        let known = plans.iter().map(|plan| plan.name.as_str()).collect::<Vec<_>>().join(", ");
        if let Some(dropped) = dropped.into_iter().find(|dropped| dropped.name == key) {
            return Err(Error::DroppedWindow {
                index: index.to_path_buf(),
                key: dropped.name,
                reason: dropped.reason,
            });
        }
        plans.into_iter().find(|plan| plan.name == key).ok_or_else(|| Error::NoWindow {
            index: index.to_path_buf(),
            key: key.to_owned(),
            known,
        })
    }

    /// The windows of an index file (pixelSplat's layout, keys `scene/window` or `scene`) for the scene in a folder, or the scenes
    /// below it; and what of both is left out. Targets that are context views too are no measure of new views and are left out.
    ///
    /// # Errors
    /// If a file cannot be read, or the index has no window for any of the scenes.
    pub fn of_index(root: &Path, index: &Path, reading: Reading) -> Result<(Vec<Self>, Vec<Dropped>)> {
        let found = open_all(root, reading.format)?;
        let index = read_index(index)?;
        let (mut plans, mut dropped) = (Vec::new(), dropped_scenes(found.dropped));
        let left_out = |scene: &str| index.dropped.iter().any(|entry| scene_of(&entry.key) == scene);
        let names: Vec<String> = found.scenes.iter().map(|scene| scene.name.clone()).collect();
        for dataset in found.scenes {
            let dataset = Arc::new(dataset);
            match index.windows_of(&dataset) {
                Ok(windows) => {
                    for window in windows {
                        plans.push(Self::of_window(window, &dataset, reading)?);
                    }
                }
                Err(_) if left_out(&dataset.name) => {}
                // Of one scene the caller wants these windows; of many he has an index.
                Err(error) if names.len() == 1 => return Err(error.into()),
                Err(error) => dropped.push(Dropped::new(&dataset.name, &Error::from(error))),
            }
        }
        // With a single scene the index may well speak of others.
        let is_ours = |scene: &str| names.len() > 1 || names.iter().any(|name| name == scene);
        let empty = index.dropped.iter().filter(|entry| is_ours(scene_of(&entry.key)));
        dropped.extend(left_out_by_index(empty));
        let mut missing: Vec<&str> = index.windows.iter().map(|window| window.scene.as_str()).collect();
        missing.dedup();
        for scene in
            missing.into_iter().filter(|scene| names.len() > 1 && !names.iter().any(|name| name == scene))
        {
            let reason = format!("in the index, but not below {}", root.display());
            dropped.push(Dropped { name: scene.to_owned(), reason, failed: true });
        }
        Ok((plans, dropped))
    }

    /// All windows of the scene in a folder, or of the scenes below it, in the order of their names, as `windows` says. A scene that cannot be read, or gives no window, is returned as dropped.
    ///
    /// # Errors
    /// If the folder cannot be read, or there is nothing to evaluate.
    pub fn below(root: &Path, windows: Windows, reading: Reading) -> Result<(Vec<Self>, Vec<Dropped>)> {
        let found = open_all(root, reading.format)?;
        let is_one = found.scenes.len() == 1;
        let (mut plans, mut dropped) = (Vec::new(), dropped_scenes(found.dropped));
        for dataset in found.scenes {
            let name = dataset.name.clone();
            match Self::of_scene(dataset, windows, reading) {
                Ok((found, left_out)) => {
                    plans.extend(found);
                    dropped.extend(left_out);
                }
                Err(error) if is_one => return Err(error),
                Err(error) => dropped.push(Dropped::new(&name, &error)),
            }
        }
        Ok((plans, dropped))
    }

    /// Windows to train on: one about every frame ([`view_data::windows_around`]) of the scene in a folder, or of the scenes below it.
    /// Pictures keep their shape and are scaled down to about `pixels` pixels. Index files are not looked at: what is in them is for
    /// evaluations. Scenes and windows that are left out are returned as dropped.
    ///
    /// # Errors
    /// If the folder cannot be read.
    pub fn around_frames(
        root: &Path,
        views: usize,
        pixels: usize,
        format: Option<Format>,
    ) -> Result<(Vec<Self>, Vec<Dropped>)> {
        let found = open_all(root, format)?;
        let (mut plans, mut dropped) = (Vec::new(), dropped_scenes(found.dropped));
        for dataset in found.scenes {
            let name = dataset.name.clone();
            match Self::around_frames_of(dataset, views, pixels) {
                Ok((found, left_out)) => {
                    plans.extend(found);
                    dropped.extend(left_out);
                }
                Err(error) => dropped.push(Dropped::new(&name, &error)),
            }
        }
        Ok((plans, dropped))
    }

    fn around_frames_of(dataset: Dataset, views: usize, pixels: usize) -> Result<(Vec<Self>, Vec<Dropped>)> {
        let (present, cameras, depth) = surveyed(&dataset, views)?;
        let (mut windows, dropped) = windows_around(&dataset.name, &cameras, views, depth)?;
        let reading =
            Reading { size: cameras.first().map(|first| reduced(first, pixels)), ..Reading::default() };
        let dataset = Arc::new(dataset);
        for window in &mut windows {
            window.context.iter_mut().chain(&mut window.target).for_each(|frame| *frame = present[*frame]);
        }
        let plans = windows.iter().map(|window| Self::of_window(window, &dataset, reading));
        Ok((plans.collect::<Result<_>>()?, dropped_scenes(dropped)))
    }

    fn of_scene(dataset: Dataset, windows: Windows, reading: Reading) -> Result<(Vec<Self>, Vec<Dropped>)> {
        let dataset = Arc::new(dataset);
        let index = dataset.root.join(INDEX);
        let (of_scene, left_out) = if windows.index && index.is_file() {
            let index = read_index(&index)?;
            let of_scene = index.windows_of(&dataset)?.into_iter().cloned().collect();
            let empty = index.dropped.iter().filter(|entry| scene_of(&entry.key) == dataset.name);
            (of_scene, left_out_by_index(empty).collect())
        } else if let Some(count) =
            windows.along.or_else(|| is_video(dataset.format).then_some(ALONG_A_VIDEO))
        {
            let (windows, cut_short) = along(&dataset, windows.views, count)?;
            (windows, dropped_scenes(cut_short))
        } else {
            return Ok((vec![Self::selected(&dataset, windows.views, reading)?], Vec::new()));
        };
        let plans = of_scene.iter().map(|window| Self::of_window(window, &dataset, reading));
        Ok((plans.collect::<Result<_>>()?, left_out))
    }

    fn of_window(window: &view_data::Window, dataset: &Arc<Dataset>, reading: Reading) -> Result<Self> {
        let held_out = |position: &usize| !window.context.contains(position);
        let choice = Choice {
            context: window.context.clone(),
            targets: window.target.iter().copied().filter(held_out).collect(),
            uncovered: None,
        };
        Self::photographs(window.key.clone(), Arc::clone(dataset), choice, None, reading)
    }

    fn photographs(
        name: String,
        dataset: Arc<Dataset>,
        choice: Choice,
        selected: Option<usize>,
        reading: Reading,
    ) -> Result<Self> {
        let hint = if reading.depth_hint {
            let depths = dataset.measured_depth()?;
            let depths = depths.ok_or_else(|| Error::NoDepthHint { path: dataset.file.clone() })?;
            Some(DepthRange::Known { near: depths.p0_5, far: depths.p99_5 })
        } else {
            None
        };
        Ok(Self {
            name,
            source: Source::Photographs(Photographs { dataset, choice, size: reading.size, hint, selected }),
            memory: None,
        })
    }

    /// The same plan, whose window with its targets is loaded once and then stays in memory, with the time that it took: for many
    /// methods on few windows.
    #[must_use]
    pub fn kept_in_memory(self) -> Self {
        Self { memory: Some(Arc::default()), ..self }
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

    /// The files that the window is read from; none where the scene is simulated.
    #[must_use]
    pub fn files(&self) -> Vec<PathBuf> {
        match &self.source {
            Source::Simulated { .. } => Vec::new(),
            Source::Photographs(photographs) => photographs.dataset.files(),
        }
    }

    /// What was subtracted from all positions, because the scene lies far from the origin of its world, scene units.
    #[must_use]
    pub fn offset(&self) -> Option<[f64; 3]> {
        match &self.source {
            Source::Simulated { .. } => None,
            Source::Photographs(photographs) => photographs.dataset.offset.map(Into::into),
        }
    }

    /// What the files of the data set list and the data set does not use, and why.
    #[must_use]
    pub fn ledger(&self) -> &[view_data::Dropped] {
        match &self.source {
            Source::Simulated { .. } => &[],
            Source::Photographs(photographs) => &photographs.dataset.dropped,
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

    /// The same window with pictures of another size, width and height in pixels.
    #[must_use]
    pub fn at_size(&self, size: (usize, usize)) -> Self {
        let source = match &self.source {
            Source::Simulated { scene, .. } => Source::Simulated { scene: *scene, size },
            Source::Photographs(photographs) => {
                Source::Photographs(Photographs { size: Some(size), ..photographs.clone() })
            }
        };
        Self { name: self.name.clone(), source, memory: None }
    }

    /// The same window with photographs scaled down to about so many pixels, if they have more, in the shape of the first of them. Simulated scenes
    /// keep their size.
    ///
    /// # Errors
    /// If the first photograph's camera cannot be read.
    pub fn of_about(&self, pixels: usize) -> Result<Self> {
        let Source::Photographs(Photographs { dataset, choice, .. }) = &self.source else {
            return Ok(self.clone());
        };
        let first = choice.context.first().map(|&frame| dataset.camera(frame)).transpose()?;
        Ok(first.map_or_else(|| self.clone(), |first| self.at_size(reduced(&first, pixels))))
    }

    /// Everything that decides what the views of a simulated scene look like, as text; for caches.
    #[must_use]
    pub fn description(&self) -> Option<String> {
        match &self.source {
            Source::Simulated { scene, size } => Some(description(*scene, *size)),
            Source::Photographs(_) => None,
        }
    }

    /// Loads the views, the targets only if they are wanted.
    ///
    /// # Errors
    /// If a file is missing or wrong.
    pub fn load(&self, with_targets: bool) -> Result<Window> {
        let Some(memory) = self.memory.as_ref().filter(|_| with_targets) else {
            return self.read(with_targets);
        };
        if let Some(window) = memory.get() {
            return Ok(window.clone());
        }
        let window = self.read(true)?;
        Ok(memory.get_or_init(|| window).clone())
    }

    fn read(&self, with_targets: bool) -> Result<Window> {
        let Photographs { dataset, choice, size, .. } = match &self.source {
            Source::Simulated { scene, size } => return simulated_window(*scene, *size),
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
#[must_use]
pub fn scene_of(name: &str) -> &str {
    name.rsplit_once('/').map_or(name, |(scene, _)| scene)
}

/// Layouts whose frames are those of a video: neighbours in the list are neighbours in space.
fn is_video(format: Format) -> bool {
    matches!(format, Format::Replica | Format::Tum | Format::ScanNet | Format::Re10k | Format::Chunk)
}

/// Windows along the path of the frames that are there.
fn along(
    dataset: &Dataset,
    views: usize,
    count: usize,
) -> Result<(Vec<view_data::Window>, Vec<view_data::Dropped>)> {
    let (present, cameras, depth) = surveyed(dataset, views)?;
    let (mut windows, dropped) = windows_along(&dataset.name, &cameras, views, count, depth)?;
    for window in &mut windows {
        window.context.iter_mut().chain(&mut window.target).for_each(|frame| *frame = present[*frame]);
    }
    Ok((windows, dropped))
}

/// The size of a camera's pictures, scaled down to about so many pixels.
fn reduced(camera: &Camera, pixels: usize) -> (usize, usize) {
    let [width, height] = [camera.width(), camera.height()];
    let scale = (pixels as f64 / (width * height) as f64).sqrt().min(1.0);
    let side = |side: usize| ((side as f64 * scale).round() as usize).max(1);
    (side(width), side(height))
}

/// Positions and cameras of the frames that are there, and the depth of the scene.
fn surveyed(dataset: &Dataset, views: usize) -> Result<(Vec<usize>, Vec<Camera>, SceneDepth)> {
    let present = dataset.present();
    let cameras =
        present.iter().map(|&frame| dataset.camera(frame)).collect::<view_data::Result<Vec<_>>>()?;
    let depth = match dataset.measured_depth()? {
        Some(depth) => depth.into(),
        None => estimate_scene_depth(&cameras).ok_or_else(|| Error::OnePlace {
            path: dataset.file.clone(),
            frames: present.len(),
            views,
        })?,
    };
    Ok((present, cameras, depth))
}

fn dropped_scenes(entries: Vec<view_data::Dropped>) -> Vec<Dropped> {
    let failed = |entry: view_data::Dropped| Dropped { name: entry.key, reason: entry.reason, failed: true };
    entries.into_iter().map(failed).collect()
}

fn left_out_by_index<'a>(
    entries: impl Iterator<Item = &'a view_data::Dropped>,
) -> impl Iterator<Item = Dropped> {
    entries.map(|entry| Dropped { name: entry.key.clone(), reason: entry.reason.clone(), failed: false })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_kept_in_memory_is_loaded_once_and_other_sizes_are_not_it() {
        let plan = Plan::simulated(SimulatedScene::Courtyard, (24, 16)).kept_in_memory();
        let without_targets = plan.load(false).unwrap();
        assert!(without_targets.context.len() == 6);
        let (first, second) = (plan.clone().load(true).unwrap(), plan.load(true).unwrap());
        // Two loads never take the same nanoseconds.
        assert_eq!(first.load_seconds, second.load_seconds);
        assert_eq!(first.sha256(), second.sha256());
        assert!(!second.targets.is_empty());
        assert_eq!(plan.at_size((12, 8)).load(true).unwrap().context[0].image().width(), 12);
    }
}
