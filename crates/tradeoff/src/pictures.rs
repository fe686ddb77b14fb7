//! Pictures of points, kept as files, so that a report can show them after an interruption and from several shards.

use super::SweepError;
use evaluate::Rendered;
use gs_scene::write_atomically;
use report_parts::Picture;
use scene_windows::Window;
use std::fs;
use std::path::{Path, PathBuf};

/// Windows whose pictures are kept: the first ones.
const WINDOWS: usize = 3;
/// Greatest width of a picture, pixels.
const WIDTH: u32 = 480;
/// JPEG quality.
const QUALITY: u8 = 85;

/// A folder of pictures: `I/photograph.jpg` of the `I`th window, `I/POINT.jpg` and `I/POINT-error.jpg`.
#[derive(Debug, Clone)]
pub struct Pictures {
    folders: Vec<PathBuf>,
}

impl Pictures {
    /// Pictures below the folder of a sweep, or of several that are shards of one; new ones go below the first.
    #[must_use]
    pub fn below(sweeps: &[PathBuf]) -> Self {
        Self { folders: sweeps.iter().map(|folder| folder.join("pictures")).collect() }
    }

    /// Keeps how the target in the middle was met, if the window at this position of the sweep's list is one of those shown.
    pub(super) fn keep(
        &self,
        position: usize,
        window: &Window,
        point: &str,
        renderings: &[Rendered],
    ) -> report_parts::Result<()> {
        let middle = window.targets.len() / 2;
        let (Some(target), Some(rendering), Some(folder)) =
            (window.targets.get(middle), renderings.get(middle), self.folders.first())
        else {
            return Ok(());
        };
        if position >= WINDOWS {
            return Ok(());
        }
        let folder = folder.join(position.to_string());
        let save = |name: &str, picture: Picture| -> report_parts::Result<()> {
            let bytes = picture.at_most(WIDTH).to_jpeg(QUALITY)?;
            Ok(write_atomically(&folder.join(name), |out| out.write_all(&bytes))?)
        };
        save("photograph.jpg", Picture::of_image(target.image()))?;
        save(&format!("{point}.jpg"), Picture::of_image(&rendering.image))?;
        save(&format!("{point}-error.jpg"), Picture::of_error(target.image(), &rendering.image))
    }

    /// Positions of the windows that have pictures, ascending.
    pub(super) fn windows(&self) -> Vec<usize> {
        (0..WINDOWS).filter(|&position| self.find(position, "photograph").is_some()).collect()
    }

    /// A picture's JPEG, if it was kept.
    pub(super) fn read(&self, position: usize, name: &str) -> Result<Option<Vec<u8>>, SweepError> {
        let Some(path) = self.find(position, name) else { return Ok(None) };
        let bytes = fs::read(&path).map_err(|source| SweepError::Io { action: "read", path, source })?;
        Ok(Some(bytes))
    }

    fn find(&self, position: usize, name: &str) -> Option<PathBuf> {
        let file = Path::new(&position.to_string()).join(format!("{name}.jpg"));
        self.folders.iter().map(|folder| folder.join(&file)).find(|path| path.is_file())
    }
}
