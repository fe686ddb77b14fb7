//! The content of a sparse model, from text or binary files.

use super::cameras::CameraModel;
use crate::files::{Binary, Line, Lines};
use crate::{Error, FormatRule, Lens, PoseRule, Result, ScenePoint};
use glam::{DQuat, DVec2, DVec3};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The files of a model, binary where both kinds lie there.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ModelFiles {
    /// The folder.
    pub(super) folder: PathBuf,
    pub(super) is_binary: bool,
}

/// A registered image.
pub(super) struct ModelImage {
    pub(super) name: String,
    pub(super) camera: u32,
    /// World to camera.
    pub(super) rotation: DQuat,
    pub(super) translation: DVec3,
}

/// COLMAP's mark of a feature without a point, -1 as an unsigned number.
const NO_POINT: u64 = u64::MAX;
/// Longest name of an image, bytes.
const MAX_NAME: usize = 4096;
/// Bytes of a feature: x, y, id of its point.
const FEATURE: u64 = 24;

/// Whether a line is that of an image, IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, and not one of features, which are numbers alone.
fn is_image(text: &str) -> bool {
    let words: Vec<&str> = text.split_whitespace().take(10).collect();
    let is_number = |word: &&str| word.parse::<f64>().is_ok();
    let last = text.split_whitespace().next_back();
    words.len() == 10
        && words[0].parse::<u32>().is_ok()
        && words[1..8].iter().all(is_number)
        && words[8].parse::<u32>().is_ok()
        && !last.as_ref().is_some_and(is_number)
}

impl ModelFiles {
    /// The model in a folder, if there is one.
    pub(super) fn find(folder: &Path) -> Option<Self> {
        let has = |extension: &str| {
            ["cameras", "images"].iter().all(|name| folder.join(format!("{name}.{extension}")).is_file())
        };
        let is_binary = has("bin");
        (is_binary || has("txt")).then(|| Self { folder: folder.to_path_buf(), is_binary })
    }

    pub(super) fn path(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.{}", if self.is_binary { "bin" } else { "txt" }))
    }

    /// The lenses by the ids of their cameras.
    pub(super) fn cameras(&self) -> Result<HashMap<u32, Lens>> {
        let path = self.path("cameras");
        let mut cameras = HashMap::new();
        if self.is_binary {
            let mut file = Binary::open(&path)?;
            for _ in 0..file.count("cameras", 48)? {
                let id = file.u32("camera id")?;
                let model = CameraModel::by_number(file.i32("camera model")?);
                let model = model.map_err(|rule| file.broken(rule))?;
                let (width, height) = (file.u64("width")?, file.u64("height")?);
                let parameters = (0..model.parameters()).map(|_| file.f64("camera parameters"));
                let parameters = parameters.collect::<Result<Vec<_>>>()?;
                let lens = model.lens(width, height, &parameters).map_err(|rule| file.broken(rule))?;
                if cameras.insert(id, lens).is_some() {
                    return Err(file.broken(twice("camera id", id)));
                }
            }
            file.end()?;
        } else {
            let mut lines = Lines::open(&path)?;
            while let Some(line) = lines.next_entry()? {
                let expected = "CAMERA_ID MODEL WIDTH HEIGHT PARAMS";
                let ([id, model, width, height], rest) = line.split(expected)?;
                let id = line.parsed("CAMERA_ID", id, "a whole number")?;
                let model = CameraModel::by_name(model).map_err(|rule| line.broken(rule))?;
                let width = line.parsed("WIDTH", width, "a whole number of pixels")?;
                let height = line.parsed("HEIGHT", height, "a whole number of pixels")?;
                let parameters = rest.split_whitespace().map(|word| line.number("a parameter", word));
                let parameters = parameters.collect::<Result<Vec<_>>>()?;
                let lens = model.lens(width, height, &parameters).map_err(|rule| line.broken(rule))?;
                if cameras.insert(id, lens).is_some() {
                    return Err(line.broken(twice("camera id", id)));
                }
            }
        }
        Ok(cameras)
    }

    /// Calls `image` with every registered image in the file's order, and `feature` with the features that have a
    /// point: position of the image, pixel, id of the point.
    pub(super) fn images(
        &self,
        mut image: impl FnMut(ModelImage, &dyn Fn(FormatRule) -> Error) -> Result<()>,
        mut feature: Option<&mut dyn FnMut(usize, DVec2, u64)>,
    ) -> Result<()> {
        let path = self.path("images");
        if self.is_binary {
            let mut file = Binary::open(&path)?;
            let count = file.count("images", 73)?;
            for position in 0..count as usize {
                file.u32("image id")?;
                let [w, x, y, z] = file.f64s("quaternion")?;
                let translation = file.f64s("translation")?;
                let camera = file.u32("camera id")?;
                let name = file.text("image name", MAX_NAME)?;
                let found = registered(name, camera, [w, x, y, z], translation);
                image(found.map_err(|rule| file.broken(rule))?, &|rule| file.broken(rule))?;
                let features = file.count("features", FEATURE)?;
                match &mut feature {
                    None => file.skip("features", features * FEATURE)?,
                    Some(feature) => {
                        for _ in 0..features {
                            let [x, y] = file.f64s("feature")?;
                            match file.u64("point id")? {
                                NO_POINT => {}
                                point => feature(position, DVec2::new(x, y), point),
                            }
                        }
                    }
                }
            }
            return file.end();
        }
        let mut lines = Lines::open(&path)?;
        let mut position = 0;
        while let Some(first) = lines.next_entry()? {
            let mut line = first;
            // The second line of an image may be empty, and is no comment whatever it begins with. Files that somebody wrote by hand may
            // have no second lines at all.
            let second = loop {
                let found = registered_in(&line)?;
                image(found, &|rule| line.broken(rule))?;
                match lines.next_line()? {
                    Some(next) if is_image(next.text) => line = next,
                    second => break second,
                }
                position += 1;
            };
            let Some(line) = second else { break };
            if let Some(feature) = &mut feature {
                let words: Vec<&str> = line.text.split_whitespace().collect();
                for triple in words.chunks(3) {
                    let &[x, y, point] = triple else {
                        return Err(line.broken(FormatRule::Words {
                            expected: "X Y POINT3D_ID for each feature",
                            found: words.len(),
                        }));
                    };
                    let [x, y] = line.numbers("feature", [x, y])?;
                    let point: i64 = line.parsed("POINT3D_ID", point, "a whole number")?;
                    if point != -1 {
                        feature(position, DVec2::new(x, y), point.cast_unsigned());
                    }
                }
            }
            position += 1;
        }
        Ok(())
    }

    /// The points and their ids, without observations.
    pub(super) fn points(&self) -> Result<Vec<(u64, ScenePoint)>> {
        let path = self.path("points3D");
        let mut points = Vec::new();
        let point = |position: [f64; 3], colour, error: f64| {
            let finite = position.into_iter().find(|value| !value.is_finite());
            match finite {
                Some(found) => Err(FormatRule::NotFinite { what: "position of a point", found }),
                None => Ok(ScenePoint {
                    position: DVec3::from(position),
                    colour: Some(colour),
                    error: error.is_finite().then_some(error),
                    observations: Vec::new(),
                }),
            }
        };
        if self.is_binary {
            let mut file = Binary::open(&path)?;
            for _ in 0..file.count("points", 51)? {
                let id = file.u64("point id")?;
                let position = file.f64s("position")?;
                let colour = file.bytes("colour")?;
                let found = point(position, colour, file.f64("error")?);
                points.push((id, found.map_err(|rule| file.broken(rule))?));
                let track = file.count("track", 8)?;
                file.skip("track", track * 8)?;
            }
            file.end()?;
        } else {
            let mut lines = Lines::open(&path)?;
            while let Some(line) = lines.next_entry()? {
                let ([id, x, y, z, r, g, b, error], _) = line.split("POINT3D_ID X Y Z R G B ERROR")?;
                let id = line.parsed("POINT3D_ID", id, "a whole number")?;
                let position = line.numbers("position", [x, y, z])?;
                let mut colour = [0; 3];
                for (value, word) in colour.iter_mut().zip([r, g, b]) {
                    *value = line.parsed("colour", word, "a whole number from 0 to 255")?;
                }
                let error = line.parsed("ERROR", error, "a number")?;
                points.push((id, point(position, colour, error).map_err(|rule| line.broken(rule))?));
            }
        }
        Ok(points)
    }
}

fn twice(what: &'static str, id: u32) -> FormatRule {
    FormatRule::Duplicate { what, found: id.to_string() }
}

fn registered_in(line: &Line<'_>) -> Result<ModelImage> {
    let expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME";
    let ([id, w, x, y, z, tx, ty, tz, camera], name) = line.split(expected)?;
    let _: u32 = line.parsed("IMAGE_ID", id, "a whole number")?;
    let quaternion = line.numbers("quaternion", [w, x, y, z])?;
    let translation = line.numbers("translation", [tx, ty, tz])?;
    let camera = line.parsed("CAMERA_ID", camera, "a whole number")?;
    if name.is_empty() {
        return Err(line.broken(FormatRule::Words { expected, found: 9 }));
    }
    if name.len() > MAX_NAME {
        return Err(line.broken(FormatRule::TooLong { what: "image name", most: MAX_NAME }));
    }
    registered(name.to_owned(), camera, quaternion, translation).map_err(|rule| line.broken(rule))
}

/// Quaternions have w first and any length but 0, as COLMAP reads them.
fn registered(
    name: String,
    camera: u32,
    found: [f64; 4],
    translation: [f64; 3],
) -> std::result::Result<ModelImage, FormatRule> {
    if let Some(&found) = translation.iter().find(|value| !value.is_finite()) {
        return Err(FormatRule::NotFinite { what: "translation", found });
    }
    let rotation = crate::dataset::unit_quaternion(found).map_err(FormatRule::Pose)?;
    let below = Path::new(&name).components().all(|part| matches!(part, std::path::Component::Normal(_)));
    if !below || name.contains('\0') {
        return Err(FormatRule::ImageName { name });
    }
    Ok(ModelImage { name, camera, rotation, translation: DVec3::from(translation) })
}

impl From<PoseRule> for FormatRule {
    fn from(rule: PoseRule) -> Self {
        Self::Pose(rule)
    }
}
