//! Windows with cached depth and features of the frozen backbone, on disk: ray tracing and stereo take seconds, a training
//! step less.

use crate::sources::Sources;
use crate::{Error, Result};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, DepthMap, Image, Intrinsics, View};
use safetensors::tensor::Dtype;
use scene_windows::{GeometryCache, Plan, Window, hexadecimal, scene_of};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use sparsesplat::{Geometry, Predictor, Wanted};
use std::ops::Range;
use std::path::{Path, PathBuf};
use tensor_files::{Kept, KeptFault, KeptTensor, singles, write_kept};

/// Changes when the layout of a file of views does.
const VERSION: u32 = 3;

/// What the files are.
const KIND: &str = "case";

/// A window, ready to be trained on.
#[derive(Debug, Clone)]
pub struct Case {
    /// `scene/window`.
    pub name: String,
    /// Context views.
    pub context: Vec<View>,
    /// Held-out views.
    pub targets: Vec<View>,
    /// What the backbone says of the context views, with features.
    pub geometry: Geometry,
    /// Whether the views are photographs: those have exposures that nobody knows, and show what no context view does.
    pub photographs: bool,
}

/// Windows to train on: the views of each in a file of the cache, and in another, which evaluations share, what the backbone says of them.
#[derive(Debug, Clone)]
pub struct Cases {
    kept: Vec<KeptCase>,
    geometry: GeometryCache,
    /// Where passes draw their windows.
    sources: Sources,
    hash: String,
}

/// A window in the cache.
#[derive(Debug, Clone)]
struct KeptCase {
    views: PathBuf,
    /// The backbone as it sees them.
    predictor: Predictor,
    photographs: bool,
}

/// What does not fit a tensor.
#[derive(Serialize, Deserialize)]
struct Header {
    name: String,
    context: Vec<Posed>,
    targets: Vec<Posed>,
}

#[derive(Serialize, Deserialize)]
struct Posed {
    name: String,
    lens: Intrinsics,
    rotation: DMat3,
    translation: DVec3,
}

impl Cases {
    /// The cases of `plans`; those that are not in the folder `cache` yet are made. `on_case` is told the name of each when it is
    /// there, or with the reason when it is left out because its views do not suffice for the backbone.
    ///
    /// # Errors
    /// If a window cannot be loaded, has no held-out views, none is left, or a file cannot be read or written.
    pub fn open(
        plans: &[Plan],
        predictor: &Predictor,
        cache: &Path,
        on_case: &mut dyn FnMut(&str, Option<&scene_windows::Error>),
    ) -> Result<Self> {
        if plans.is_empty() {
            return Err(Error::NoWindows);
        }
        let geometry = GeometryCache { folder: cache.to_path_buf() };
        let mut kept = Vec::with_capacity(plans.len());
        let mut scenes: Vec<(String, Range<usize>)> = Vec::new();
        let mut all = Sha256::new();
        let mut insufficient = None;
        for plan in plans {
            let config = predictor.config();
            let depth_range = plan.depth_range(config.depth_range);
            let predictor = predictor.with_config(sparsesplat::Config { depth_range, ..config.clone() })?;
            let (described, loaded) = match plan.description() {
                Some(description) => (description, None),
                None => {
                    let window = plan.load(true)?;
                    (window.exact_sha256(), Some(window))
                }
            };
            let key = hexadecimal(&Sha256::digest(format!("{VERSION}\n{described}")));
            let file =
                cache.join(format!("{}-{}.views.safetensors", plan.name().replace('/', "-"), &key[..16]));
            if !file.exists() {
                let window = match loaded {
                    Some(window) => window,
                    None => plan.load(true)?,
                };
                Views::of_window(window)?.write(&file)?;
            }
            let views = Views::read(&file)?;
            let wanted = Wanted::DepthAndFeatures;
            let geometry_file = geometry.path(&views.name, &views.context, &predictor, wanted);
            if !geometry_file.exists() {
                match geometry.geometry(&views.name, &views.context, &predictor, wanted) {
                    Err(error @ scene_windows::Error::Predict(_)) => {
                        on_case(&views.name, Some(&error));
                        insufficient = Some(error);
                        continue;
                    }
                    made => made?,
                };
            }
            // The name of the file changes with the backbone, its settings, the depth range and what the backbone computes.
            all.update(&key);
            all.update(geometry_file.file_name().unwrap_or_default().as_encoded_bytes());
            match scenes.last_mut() {
                Some((scene, windows)) if scene == scene_of(&views.name) => windows.end += 1,
                _ => scenes.push((scene_of(&views.name).to_owned(), kept.len()..kept.len() + 1)),
            }
            kept.push(KeptCase { views: file, predictor, photographs: plan.choice().is_some() });
            on_case(&views.name, None);
        }
        if let (true, Some(error)) = (kept.is_empty(), insufficient) {
            return Err(error.into());
        }
        let scenes = scenes.into_iter().map(|(_, windows)| windows).collect();
        let sources = Sources::one(scenes);
        Ok(Self { kept, geometry, sources, hash: hexadecimal(&all.finalize()) })
    }

    /// These and `others`, of which passes draw a `share`.
    ///
    /// # Panics
    /// If the share is not above 0 and below 1, or the cache folders differ.
    #[must_use]
    pub fn mixed_with(mut self, others: Self, share: f64) -> Self {
        assert!(self.geometry == others.geometry, "windows of the same cache");
        self.sources.mix(self.kept.len(), others.sources, share);
        self.kept.extend(others.kept);
        let all = format!("{}\n{}\n{share}", self.hash, others.hash);
        self.hash = hexadecimal(&Sha256::digest(all));
        self
    }

    /// The window of the `pass`-th pass of a run.
    pub(crate) fn drawn(&self, seed: u64, pass: usize) -> usize {
        self.sources.drawn(seed, pass)
    }

    /// Number of cases.
    #[must_use]
    pub fn len(&self) -> usize {
        self.kept.len()
    }

    /// Whether there are none; never.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// SHA-256 of what decides the content of all of them.
    #[must_use]
    pub fn sha256(&self) -> &str {
        &self.hash
    }

    /// Reads a case.
    ///
    /// # Errors
    /// If a file is gone or broken.
    pub fn read(&self, index: usize) -> Result<Case> {
        let KeptCase { views, predictor, photographs } = &self.kept[index];
        let Views { name, context, targets } = Views::read(views)?;
        let geometry = self.geometry.geometry(&name, &context, predictor, Wanted::DepthAndFeatures)?;
        Ok(Case { name, context, targets, geometry, photographs: *photographs })
    }
}

/// The views of a window.
struct Views {
    name: String,
    context: Vec<View>,
    targets: Vec<View>,
}

impl Views {
    fn of_window(window: Window) -> Result<Self> {
        if window.targets.is_empty() {
            return Err(Error::NoTargets { window: window.name });
        }
        Ok(Self { name: window.name, context: window.context, targets: window.targets })
    }

    fn write(&self, path: &Path) -> Result<()> {
        let posed = |view: &View| Posed {
            name: view.name().to_owned(),
            lens: *view.camera().intrinsics(),
            rotation: view.camera().rotation(),
            translation: view.camera().translation(),
        };
        let header = Header {
            name: self.name.clone(),
            context: self.context.iter().map(posed).collect(),
            targets: self.targets.iter().map(posed).collect(),
        };
        let mut tensors: Vec<KeptTensor> = Vec::new();
        let mut pictures = |kind: &str, views: &[View]| {
            for (i, view) in views.iter().enumerate() {
                let (width, height) = (view.image().width(), view.image().height());
                tensors.push((
                    format!("{kind}.{i}.image"),
                    Dtype::U8,
                    vec![height, width, 3],
                    view.image().to_rgb8(),
                ));
                if let Some(depth) = view.depth() {
                    let bytes = depth.data().iter().flat_map(|v| v.to_le_bytes()).collect();
                    tensors.push((format!("{kind}.{i}.depth"), Dtype::F32, vec![height, width], bytes));
                }
            }
        };
        pictures("context", &self.context);
        pictures("targets", &self.targets);
        write_kept(path, KIND, &header, &tensors)
            .map_err(|source| Error::CacheFile { path: path.to_path_buf(), source })
    }

    fn read(path: &Path) -> Result<Self> {
        let read = || {
            let (header, kept): (Header, Kept) = Kept::read(path, KIND)?;
            let views = |kind: &str, posed: &[Posed]| {
                let all =
                    posed.iter().enumerate().map(|(i, posed)| posed.view(&kept, &format!("{kind}.{i}")));
                all.collect::<std::result::Result<Vec<View>, KeptFault>>()
            };
            let (context, targets) = (views("context", &header.context)?, views("targets", &header.targets)?);
            Ok(Self { name: header.name, context, targets })
        };
        read().map_err(|source| Error::CacheFile { path: path.to_path_buf(), source })
    }
}

impl Posed {
    /// The view whose tensors' names begin so.
    fn view(&self, kept: &Kept, name: &str) -> std::result::Result<View, KeptFault> {
        let (width, height) = (self.lens.width, self.lens.height);
        let bytes = kept.expect(&format!("{name}.image"), Dtype::U8, &[height, width, 3])?;
        let image = Image::from_rgb8(width, height, bytes).map_err(KeptFault::Scene)?;
        let camera = Camera::new(self.lens, self.rotation, self.translation).map_err(KeptFault::Scene)?;
        let depth = match kept.tensor(&format!("{name}.depth"), Dtype::F32, 2)? {
            Some((_, bytes)) => Some(DepthMap::new(width, height, singles(bytes)).map_err(KeptFault::Scene)?),
            None => None,
        };
        View::new(self.name.clone(), image, camera, depth).map_err(KeptFault::Scene)
    }
}
