//! Windows over views that are selected by their overlap.

use super::{Choice, Photographs, Plan, Reading, Source};
use crate::{Error, Result, Window};
use std::path::Path;
use std::sync::Arc;
use view_data::{Dataset, SceneDepth, estimate_scene_depth, open, select_views};

impl Plan {
    /// A window over views of a scene chosen by their overlap; the targets are the frames between them.
    ///
    /// # Errors
    /// If the scene cannot be read, or has not that many connected views.
    pub fn selection(input: &Path, views: usize, reading: Reading) -> Result<Self> {
        Self::selected(&Arc::new(open(input, reading.format)?), views, reading)
    }

    pub(super) fn selected(dataset: &Arc<Dataset>, views: usize, reading: Reading) -> Result<Self> {
        // Frames without a picture are no candidates.
        let present = dataset.present();
        if present.len() < views.min(dataset.frames.len()) {
            let missing = dataset.frames.iter().filter(|frame| frame.image.is_missing());
            let missing = missing.map(|frame| frame.name.clone()).collect();
            return Err(Error::TooFewPictures {
                path: dataset.file.clone(),
                views,
                present: present.len(),
                missing,
            });
        }
        let cameras =
            present.iter().map(|&frame| dataset.camera(frame)).collect::<view_data::Result<Vec<_>>>()?;
        let measured = if reading.depth_hint { dataset.measured_depth()? } else { None };
        let choice = match measured.map(SceneDepth::from).or_else(|| estimate_scene_depth(&cameras)) {
            Some(depth) => {
                let selection = select_views(&cameras, views, depth)?;
                let positions = |chosen: Vec<usize>| chosen.into_iter().map(|i| present[i]).collect();
                Choice {
                    context: positions(selection.context),
                    targets: positions(selection.targets),
                    uncovered: Some(selection.uncovered),
                }
            }
            // A single view needs no depth to be selected by.
            None if views == 1 && !present.is_empty() => {
                Choice { context: vec![present[0]], targets: Vec::new(), uncovered: None }
            }
            None => return Err(Error::OnePlace { path: dataset.file.clone(), frames: present.len(), views }),
        };
        let name = format!("{}/selection", dataset.name);
        Self::photographs(name, Arc::clone(dataset), choice, Some(views), reading)
    }

    /// Loads as [`Plan::load`] does. Where the views were selected by their overlap, a frame whose picture cannot be decoded is left out, as one
    /// without a picture is, and views are selected anew; [`Plan::ledger`] then names it.
    ///
    /// # Errors
    /// If a file is missing or wrong, and if too few views are left without it.
    pub fn load_what_is_whole(&mut self, with_targets: bool) -> Result<Window> {
        loop {
            let error = match self.load(with_targets) {
                Ok(window) => return Ok(window),
                Err(error) => error,
            };
            let Some(next) = self.without_broken(&error) else { return Err(error) };
            *self = next;
        }
    }

    /// The plan with views selected anew, if `error` is about a picture that it can do without.
    fn without_broken(&self, error: &Error) -> Option<Self> {
        let (Source::Photographs(photographs), Error::Data(error)) = (&self.source, error) else {
            return None;
        };
        let Photographs { dataset, size, hint, selected: Some(views), .. } = photographs else { return None };
        let dataset = Arc::new(dataset.give_up(error)?);
        let reading = Reading { format: Some(dataset.format), size: *size, depth_hint: hint.is_some() };
        let plan = Self::selected(&dataset, *views, reading).ok()?;
        Some(Self { memory: self.memory.clone(), ..plan })
    }
}
