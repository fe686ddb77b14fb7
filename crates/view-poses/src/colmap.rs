//! The engine COLMAP: the program, where it is on the PATH.

use crate::engine::{Engine, Pose, Solution, Step, Task};
use crate::program;
use crate::{Error, Result};
use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use view_data::{Dataset, Frame, open_colmap};

/// COLMAP 3.8 or newer, on the CPU, without a window; a lens has a focal length, a principal point and k1. Its incremental mapper draws random
/// numbers in an order that depends on its threads: results differ from run to run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Colmap {
    /// How poses follow from matches.
    pub mapper: Mapper,
    program: PathBuf,
}

/// How COLMAP finds poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mapper {
    /// Photograph by photograph.
    #[default]
    Incremental,
    /// All at once: first rotations, then places. Version 4 has it.
    Global,
}

/// How to get it.
pub(crate) const INSTALL: &str = "Debian and Ubuntu: apt-get install colmap; macOS: brew install colmap; others: https://colmap.github.io/install.html";

const PROGRAM: &str = "colmap";
/// Enough features for poses, and a third of COLMAP's memory.
const FEATURES: &str = "4096";
/// Long side that features are found at, pixels.
const LONG_SIDE: &str = "1600";
/// Photographs with a pose from which the principal point can be found.
const ENOUGH_FOR_CENTRE: usize = 8;
/// Share of the long side that the principal point may lie beside the middle.
const CENTRE: f64 = 0.06;
/// Photographs that are matched exhaustively although they are frames of a video.
const EXHAUSTIVE: usize = 60;

impl Mapper {
    /// COLMAP's command.
    fn command(self) -> &'static str {
        match self {
            Self::Incremental => "mapper",
            Self::Global => "global_mapper",
        }
    }
}

impl Colmap {
    /// The program on the PATH.
    #[must_use]
    pub fn new(mapper: Mapper) -> Self {
        Self { mapper, program: PROGRAM.into() }
    }

    /// Whether the program is there.
    #[must_use]
    pub fn is_there() -> bool {
        program::is_there(PROGRAM)
    }

    /// A call of the program.
    fn call(&self, command: &'static str) -> Call<'_> {
        Call { program: &self.program, arguments: vec![command.into()] }
    }

    /// Whether this version has a command.
    fn has(&self, command: &str, work: &Path) -> Result<bool> {
        let help = program::run(&self.program, &["help".into()], work)?;
        Ok(help.split_whitespace().any(|word| word == command))
    }

    /// The options that a command of this version has.
    fn options(&self, command: &'static str, work: &Path) -> Result<Options> {
        Ok(Options(program::run(&self.program, &[command.into(), "-h".into()], work)?))
    }
}

impl Engine for Colmap {
    fn name(&self) -> &'static str {
        match self.mapper {
            Mapper::Incremental => "colmap",
            Mapper::Global => "colmap-global",
        }
    }

    fn can_be_asked(&self, work: &Path) -> bool {
        // A program that fails is asked, so that its failure is told.
        self.has(self.mapper.command(), work).unwrap_or(true)
    }

    fn estimate(&self, task: &Task<'_>, on_step: &(dyn Fn(Step) + Sync)) -> Result<Solution> {
        if self.program == Path::new(PROGRAM) && !Self::is_there() {
            return Err(Error::NoProgram {
                program: PROGRAM,
                purpose: "for the engine colmap",
                install: INSTALL,
            });
        }
        if !self.has(self.mapper.command(), task.work)? {
            return Err(Error::NoCommand { program: PROGRAM, command: self.mapper.command(), since: 4 });
        }
        let database = task.work.join("database.db");
        let models = task.work.join("models");
        let file = |action| {
            move |path: &Path, result: std::io::Result<()>| {
                result.map_err(|source| Error::File { action, path: path.to_path_buf(), source })
            }
        };
        file("make the folder")(&models, std::fs::create_dir_all(&models))?;

        on_step(Step::Features);
        let known = self.options("feature_extractor", task.work)?;
        for (number, camera) in task.cameras.iter().enumerate() {
            // Each call makes a camera of its own for the photographs of its list.
            let list = task.work.join(format!("camera-{number}.txt"));
            let names = task.photographs.iter().filter(|photograph| photograph.camera == number);
            let names: String = names.map(|photograph| format!("{}\n", photograph.name)).collect();
            file("write")(&list, std::fs::write(&list, names))?;
            let mut call = self
                .call("feature_extractor")
                .path("--database_path", &database)
                .path("--image_path", task.images)
                .path("--image_list_path", &list)
                .text("--ImageReader.single_camera", "1")
                .text("--ImageReader.camera_model", "SIMPLE_RADIAL")
                .text(known.first(["--FeatureExtraction.use_gpu", "--SiftExtraction.use_gpu"]), "0")
                .text(
                    known.first(["--FeatureExtraction.max_image_size", "--SiftExtraction.max_image_size"]),
                    LONG_SIDE,
                )
                .text("--SiftExtraction.max_num_features", FEATURES);
            if camera.focal_pixels.is_some() {
                let (focal, [cx, cy]) =
                    (task.focal(camera), [camera.width, camera.height].map(|side| side as f64 / 2.0));
                call = call.text("--ImageReader.camera_params", &format!("{focal},{cx},{cy},0"));
            }
            call.run(task.work)?;
        }

        on_step(Step::Match);
        let in_order = task.sequence && task.photographs.len() > EXHAUSTIVE;
        let matcher = if in_order { "sequential_matcher" } else { "exhaustive_matcher" };
        let known = self.options(matcher, task.work)?;
        self.call(matcher)
            .path("--database_path", &database)
            .text(known.first(["--FeatureMatching.use_gpu", "--SiftMatching.use_gpu"]), "0")
            .run(task.work)?;

        on_step(Step::Poses);
        let mapper = self.call(self.mapper.command());
        let mapper = match self.mapper {
            Mapper::Incremental => mapper.text("--Mapper.ba_refine_principal_point", "0"),
            Mapper::Global => {
                if task.cameras.iter().any(|camera| camera.focal_pixels.is_none()) {
                    // All at once does not find focal lengths: the fundamental matrices tell them.
                    self.call("view_graph_calibrator").path("--database_path", &database).run(task.work)?;
                }
                let known = self.options(self.mapper.command(), task.work)?;
                let on_cpu = ["--GlobalMapper.gp_use_gpu", "--GlobalMapper.ba_ceres_use_gpu"];
                let on_cpu = on_cpu.into_iter().filter(|option| known.has(option));
                on_cpu.fold(mapper, |mapper, option| mapper.text(option, "0"))
            }
        };
        let mapper = mapper
            .path("--database_path", &database)
            .path("--image_path", task.images)
            .path("--output_path", &models);
        let nothing =
            |said| Error::NothingMatches { photographs: task.photographs.len(), engine: self.name(), said };
        match mapper.run(task.work) {
            Ok(()) => {}
            // It ends with an error where it finds no model, which the folder tells.
            Err(Error::Program { said, .. }) if models_in(&models).is_empty() => return Err(nothing(said)),
            Err(error) => return Err(error),
        }
        let found = models_in(&models);
        // The largest model; of equal ones the first.
        let mut best: Option<(&Path, Dataset)> = None;
        for path in &found {
            let model = open_colmap(path)?;
            if best.as_ref().is_none_or(|(_, best)| model.frames.len() > best.frames.len()) {
                best = Some((path, model));
            }
        }
        let (path, model) = best.ok_or_else(|| nothing("no model was found".to_owned()))?;
        let refined = task.work.join("refined");
        file("make the folder")(&refined, std::fs::create_dir_all(&refined))?;
        let model = if model.frames.len() < ENOUGH_FOR_CENTRE {
            model
        } else {
            self.centred(task, path, &refined, model)?
        };
        solution(task, &model, found.len())
    }
}

impl Colmap {
    /// The model after a last adjustment in which the principal point is free: photographs may be cut, and then it is not in the middle. A
    /// point that wanders far off is not known, and the model stays what it was.
    fn centred(&self, task: &Task<'_>, path: &Path, refined: &Path, model: Dataset) -> Result<Dataset> {
        self.call("bundle_adjuster")
            .path("--input_path", path)
            .path("--output_path", refined)
            .text("--BundleAdjustment.refine_principal_point", "1")
            .run(task.work)?;
        let refined = open_colmap(refined)?;
        let is_near = |frame: &Frame| {
            let gs_scene::Intrinsics { cx, cy, width, height, .. } = frame.lens.intrinsics;
            let most = CENTRE * width.max(height) as f64;
            (cx - width as f64 / 2.0).abs() <= most && (cy - height as f64 / 2.0).abs() <= most
        };
        let kept = refined.frames.len() == model.frames.len() && refined.frames.iter().all(is_near);
        Ok(if kept { refined } else { model })
    }
}

/// The folders of models, by name.
fn models_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut models: Vec<PathBuf> = entries.filter(|path| path.join("images.bin").is_file()).collect();
    models.sort();
    models
}

fn solution(task: &Task<'_>, model: &Dataset, models: usize) -> Result<Solution> {
    let position_of: HashMap<&str, usize> = task
        .photographs
        .iter()
        .enumerate()
        .map(|(index, photograph)| (photograph.name.as_str(), index))
        .collect();
    let name = |frame: usize| {
        let name = model.frames[frame].image.path().file_name().unwrap_or_default();
        position_of.get(&*name.to_string_lossy()).copied()
    };
    let places: Vec<Option<usize>> = (0..model.frames.len()).map(name).collect();
    let why = if models > 1 {
        "belongs to a part of the scene without connection to the largest, or to none"
    } else {
        "not registered: too few matches with the others"
    };
    let mut lenses: Vec<Option<gs_scene::Lens>> = vec![None; task.cameras.len()];
    let mut poses = vec![None; task.photographs.len()];
    for (frame, place) in model.frames.iter().zip(&places) {
        if let Some(index) = *place {
            poses[index] = Some(Pose { axes: frame.axes, position: frame.position });
            lenses[task.photographs[index].camera] = Some(frame.lens);
        }
    }
    let lens = |(group, found): (&crate::CameraGroup, Option<gs_scene::Lens>)| {
        found.unwrap_or_else(|| {
            // A camera none of whose photographs has a pose.
            let focal = task.focal(group);
            let (width, height) = (group.width, group.height);
            let [cx, cy] = [width, height].map(|side| side as f64 / 2.0);
            let intrinsics = gs_scene::Intrinsics { fx: focal, fy: focal, cx, cy, width, height };
            gs_scene::Lens { intrinsics, model: gs_scene::Distortion::default().into() }
        })
    };
    let mut points = model.points()?.unwrap_or_default();
    for point in &mut points {
        point.observations.retain_mut(|seen| match places[seen.frame] {
            Some(index) => {
                seen.frame = index;
                true
            }
            None => false,
        });
    }
    Ok(Solution {
        lenses: task.cameras.iter().zip(lenses).map(lens).collect(),
        reasons: poses.iter().map(|pose| pose.is_none().then(|| why.to_owned())).collect(),
        poses,
        points,
    })
}

/// The options that a command of this version has.
struct Options(String);

impl Options {
    fn has(&self, name: &str) -> bool {
        self.0.contains(name)
    }

    /// The first of two names that is known: version 4 has other names than version 3.
    fn first(&self, names: [&'static str; 2]) -> &'static str {
        names.into_iter().find(|name| self.has(name)).unwrap_or(names[1])
    }
}

/// A call of the program.
struct Call<'a> {
    program: &'a Path,
    arguments: Vec<OsString>,
}

impl Call<'_> {
    fn path(mut self, option: &str, path: &Path) -> Self {
        self.arguments.extend([option.into(), path.into()]);
        self
    }

    fn text(mut self, option: &str, value: &str) -> Self {
        self.arguments.extend([option.into(), value.into()]);
        self
    }

    fn run(self, work: &Path) -> Result<()> {
        program::run(self.program, &self.arguments, work).map(|_| ())
    }
}

#[cfg(unix)]
#[cfg(test)]
mod tests {
    use super::*;
    use crate::CameraGroup;
    use std::os::unix::fs::PermissionsExt;
    use std::sync::{Mutex, PoisonError};
    use tempfile::TempDir;

    /// Programs are written and run one after the other: one that another thread's child still holds open for writing cannot be run.
    static ONE: Mutex<()> = Mutex::new(());

    /// What a program of this text makes of a task without photographs, in a folder of its own.
    fn estimate(mapper: Mapper, text: &str, cameras: &[CameraGroup]) -> (TempDir, Colmap, Error) {
        let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("colmap");
        std::fs::write(&program, format!("#!/bin/sh\ncd {}\n{text}\n", folder.path().display())).unwrap();
        std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
        let (images, work) = (folder.path(), folder.path());
        let task = Task { images, photographs: &[], cameras, sequence: false, seed: 0, work };
        let colmap = Colmap { mapper, program };
        let error = colmap.estimate(&task, &|_| ()).unwrap_err();
        (folder, colmap, error)
    }

    /// What a COLMAP of some version is called with, one call per line; it finds nothing.
    fn calls(
        mapper: Mapper,
        commands: &str,
        options: &str,
        focal_pixels: Option<f64>,
    ) -> (Vec<String>, Error) {
        let text = format!(
            "echo \"$@\" >> calls\ncase \"$*\" in\nhelp) echo '{commands}';;\n*-h) echo '{options}';;\nesac"
        );
        let camera =
            CameraGroup { width: 8, height: 6, name: None, focal_mm: None, focal_pixels, photographs: 0 };
        let (folder, _, error) = estimate(mapper, &text, &[camera]);
        let calls = std::fs::read_to_string(folder.path().join("calls")).unwrap();
        (calls.lines().filter(|line| !line.ends_with("-h")).map(str::to_owned).collect(), error)
    }

    fn names(calls: &[String]) -> Vec<&str> {
        calls.iter().filter_map(|call| call.split(' ').next()).collect()
    }

    #[test]
    fn version_3_is_asked_for_poses_photograph_by_photograph() {
        let options = "--SiftExtraction.use_gpu arg --SiftMatching.use_gpu arg";
        let (calls, error) = calls(Mapper::Incremental, "mapper bundle_adjuster", options, Some(9.5));
        assert_eq!(names(&calls), ["help", "feature_extractor", "exhaustive_matcher", "mapper"]);
        assert!(
            calls[1].contains("--SiftExtraction.use_gpu 0") && calls[1].contains("9.5,4,3,0"),
            "{calls:?}"
        );
        assert!(calls[2].contains("--SiftMatching.use_gpu 0"), "{calls:?}");
        assert!(matches!(error, Error::NothingMatches { engine: "colmap", .. }), "{error}");
    }

    #[test]
    fn version_4_is_asked_for_all_at_once_and_where_no_focal_length_is_known_for_that_first() {
        let options =
            "--FeatureExtraction.use_gpu arg --FeatureMatching.use_gpu arg --GlobalMapper.gp_use_gpu arg";
        for (focal, expected) in [(None, Some("view_graph_calibrator")), (Some(9.5), None)] {
            let (calls, error) = calls(Mapper::Global, "mapper global_mapper", options, focal);
            let rest = names(&calls)[3..].to_vec();
            assert_eq!(rest, expected.into_iter().chain(["global_mapper"]).collect::<Vec<_>>());
            assert!(calls[1].contains("--FeatureExtraction.use_gpu 0"), "{calls:?}");
            assert!(calls.last().unwrap().contains("--GlobalMapper.gp_use_gpu 0"), "{calls:?}");
            assert!(!calls.last().unwrap().contains("ba_ceres_use_gpu"), "{calls:?}");
            assert!(matches!(error, Error::NothingMatches { engine: "colmap-global", .. }), "{error}");
        }
        let (_, error) = self::calls(Mapper::Global, "mapper", options, None);
        assert_eq!(
            error.to_string(),
            "this version of colmap has no command global_mapper; version 4 has it"
        );
    }

    #[test]
    fn a_program_that_fails_is_asked_and_its_failure_is_told() {
        let (folder, colmap, error) = estimate(Mapper::Global, "echo no library >&2\nexit 3", &[]);
        assert!(matches!(&error, Error::Program { said, .. } if said == "no library"), "{error}");
        let _one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
        assert!(colmap.can_be_asked(folder.path()));
    }
}
