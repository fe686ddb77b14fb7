//! Views with what stereo knows of them and their true depth, in memory, and on disk: ray tracing and stereo take seconds a view.

use crate::sources::Sources;
use crate::{Error, Result};
use depth_backbone::{InputParts, Inputs, PlaneSweep};
use gs_scene::{DepthMap, View};
use half::f16;
use rayon::prelude::*;
use safetensors::tensor::Dtype;
use scene_windows::{Plan, SimulatedScene, Window, hexadecimal, scene_of, simulated_context};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::ops::Range;
use std::path::Path;
use tensor_files::{Kept, KeptFault, KeptTensor, singles, write_kept};

/// Changes when the layout of a file, the sweep or the meaning of the inputs does.
const VERSION: u32 = 1;
/// What the files are.
const KIND: &str = "depth-case";
/// Rays per pixel: coarser than a photograph, as noise is.
const SAMPLES: u32 = 4;
/// True inverse depth where nobody knows it.
pub(super) const UNKNOWN: f32 = -1.0;

/// One view.
pub(crate) struct DepthCase {
    size: (usize, usize),
    /// Channels of the blocks, half precision.
    blocks: Vec<f16>,
    base: Vec<f32>,
    own: Vec<f32>,
    unit: [f32; 2],
    /// True inverse depth, plane steps from the far end; NaN where there is no surface, [`UNKNOWN`] where nobody knows it.
    exact: Vec<f32>,
}

/// A part of a view.
pub(crate) struct Crop {
    pub(crate) inputs: Inputs,
    pub(crate) exact: Vec<f32>,
}

impl Crop {
    /// True z-depth, scene units; 0 where there is no surface, NaN where nobody knows it.
    pub(crate) fn exact_depth(&self) -> Vec<f32> {
        let depth = |&steps: &f32| if steps < 0.0 { f32::NAN } else { self.inputs.depth_of(steps) };
        self.exact.iter().map(depth).collect()
    }
}

/// What becomes of a scene or a window: its views, or why stereo refuses them.
type Made = std::result::Result<Vec<DepthCase>, depth_backbone::Error>;

impl DepthCase {
    /// `depth` is the true one, `[height, width]`; where there is none, `otherwise` is what the case says.
    fn new(inputs: &Inputs, depth: impl Iterator<Item = f32>, otherwise: f32) -> Self {
        let InputParts { size, blocks, base, own, unit } = inputs.to_parts();
        let exact = |z: f32| if z > 0.0 { ((1.0 / z - unit[0]) / unit[1]).max(0.0) } else { otherwise };
        let blocks = blocks.into_iter().map(f16::from_f32).collect();
        Self { size, blocks, base, own, unit, exact: depth.map(exact).collect() }
    }

    /// Makes the loss of every crop infinite.
    #[cfg(test)]
    pub(crate) fn spoil(&mut self) {
        self.exact.fill(f32::INFINITY);
    }

    /// Width and height in blocks.
    pub(crate) fn blocks(&self) -> (usize, usize) {
        (self.size.0.div_ceil(2), self.size.1.div_ceil(2))
    }

    /// The whole view.
    pub(crate) fn whole(&self) -> Crop {
        let (width, height) = self.blocks();
        self.crop((0, 0), (width, height), false)
    }

    /// `width` × `height` blocks from block (x, y) on, left and right swapped if `mirrored`.
    pub(crate) fn crop(
        &self,
        (x, y): (usize, usize),
        (width, height): (usize, usize),
        mirrored: bool,
    ) -> Crop {
        let columns = self.blocks().0;
        let pixels = ((2 * width).min(self.size.0 - 2 * x), (2 * height).min(self.size.1 - 2 * y));
        // Blocks that are cut at the border must stay there.
        let mirrored = mirrored && pixels.0 == 2 * width;
        let place = |i: usize, n: usize| if mirrored { n - 1 - i } else { i };
        let channels = Inputs::CHANNELS;
        let (mut blocks, mut base) = (Vec::with_capacity(width * height * channels), Vec::new());
        for row in y..y + height {
            for column in 0..width {
                let block = row * columns + x + place(column, width);
                let from = blocks.len();
                blocks.extend(self.blocks[block * channels..][..channels].iter().map(|v| v.to_f32()));
                if mirrored {
                    Inputs::mirror_block(&mut blocks[from..]);
                }
                base.push(self.base[block]);
            }
        }
        let gather = |from: &[f32]| -> Vec<f32> {
            let row = |v: usize| {
                let row = &from[(2 * y + v) * self.size.0 + 2 * x..][..pixels.0];
                (0..pixels.0).map(move |u| row[place(u, pixels.0)])
            };
            (0..pixels.1).flat_map(row).collect()
        };
        let (stereo, exact) = (gather(&self.own), gather(&self.exact));
        Crop {
            inputs: Inputs::of_parts(InputParts { size: pixels, blocks, base, own: stereo, unit: self.unit }),
            exact,
        }
    }

    fn tensors(&self, index: usize) -> Vec<KeptTensor> {
        let (width, height) = self.size;
        let (columns, rows) = self.blocks();
        let singles = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        vec![
            (
                format!("{index}.blocks"),
                Dtype::F16,
                vec![rows, columns, Inputs::CHANNELS],
                self.blocks.iter().flat_map(|v| v.to_le_bytes()).collect(),
            ),
            (format!("{index}.base"), Dtype::F32, vec![rows, columns], singles(&self.base)),
            (format!("{index}.own"), Dtype::F32, vec![height, width], singles(&self.own)),
            (format!("{index}.exact"), Dtype::F32, vec![height, width], singles(&self.exact)),
        ]
    }

    fn read(kept: &Kept, index: usize, kept_view: KeptView) -> Result<Self, KeptFault> {
        let KeptView { size: (width, height), unit } = kept_view;
        let (columns, rows) = (width.div_ceil(2), height.div_ceil(2));
        let blocks =
            kept.expect(&format!("{index}.blocks"), Dtype::F16, &[rows, columns, Inputs::CHANNELS])?;
        let values = |name: &str, shape: &[usize]| {
            Ok::<_, KeptFault>(singles(kept.expect(&format!("{index}.{name}"), Dtype::F32, shape)?))
        };
        Ok(Self {
            size: (width, height),
            blocks: blocks.as_chunks().0.iter().map(|bytes| f16::from_le_bytes(*bytes)).collect(),
            base: values("base", &[rows, columns])?,
            own: values("own", &[height, width])?,
            exact: values("exact", &[height, width])?,
            unit,
        })
    }
}

/// What does not fit a tensor.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct KeptView {
    size: (usize, usize),
    unit: [f32; 2],
}

/// The context views of a window of photographs whose depth nobody measured, with the photographs that tell how good it is.
pub(crate) struct DepthWindow {
    /// Of the context views.
    pub(crate) cases: Vec<DepthCase>,
    pub(crate) context: Vec<View>,
    pub(crate) held_out: Vec<View>,
}

impl DepthWindow {
    /// A plane step of inverse depth.
    pub(crate) fn step(&self) -> f32 {
        self.cases[0].unit[1]
    }
}

/// What is drawn at once.
pub(crate) enum Item {
    /// A view whose true depth is known, at least in part.
    View(DepthCase),
    /// Views that are compared with each other.
    Window(DepthWindow),
}

/// Views to train on.
pub struct DepthCases {
    pub(crate) items: Vec<Item>,
    /// Where steps draw their items.
    pub(crate) sources: Sources,
    hash: String,
}

/// What makes of the views of a scene or a window what is drawn.
type Packed<'a> = Box<dyn FnOnce(Vec<DepthCase>) -> Vec<Item> + 'a>;

/// A scene or a window: its name, what decides its views, what else decides the items, and how both are made.
struct Described<'a> {
    name: String,
    key: String,
    held_out: String,
    make: Box<dyn FnOnce() -> Result<Made> + 'a>,
    pack: Packed<'a>,
}

/// Every view for itself.
fn single(views: Vec<DepthCase>) -> Vec<Item> {
    views.into_iter().map(Item::View).collect()
}

impl DepthCases {
    /// The context views of generated scenes, at a size; those that are not in the folder `cache` yet are made. `on_scene` is told the
    /// name of each when it is there, or with the reason when it is left out because its views do not suffice for stereo.
    ///
    /// # Errors
    /// If a file cannot be read or written, or no scene is left.
    pub fn open(
        scenes: &[SimulatedScene],
        size: (usize, usize),
        cache: &Path,
        on_scene: &(dyn Fn(&str, Option<&depth_backbone::Error>) + Sync),
    ) -> Result<Self> {
        Self::opened(scenes, cache, on_scene, |&scene| {
            let described = Plan::simulated(scene, size).description();
            let key = format!("{VERSION} {SAMPLES} {described:?}");
            let make = Box::new(move || simulated(scene, size));
            Ok(Described {
                name: scene.to_string(),
                key,
                held_out: String::new(),
                make,
                pack: Box::new(single),
            })
        })
    }

    /// The context views of windows of photographs, as [`DepthCases::open`] keeps them. Measured depth is the truth, unknown where nothing was
    /// measured. A window without any is drawn as a whole, and its photographs are compared with each other.
    ///
    /// # Errors
    /// If a photograph or a file cannot be read or written, only some views of a window have measured depth, or no window is left.
    pub fn of_photographs(
        plans: &[Plan],
        cache: &Path,
        on_window: &(dyn Fn(&str, Option<&depth_backbone::Error>) + Sync),
    ) -> Result<Self> {
        Self::opened(plans, cache, on_window, |plan| {
            let mut window = plan.load(true)?;
            let whole = window.exact_sha256();
            let held_out = std::mem::take(&mut window.targets);
            let is_measured = window.context.iter().any(|view| view.depth().is_some());
            Ok(described(window, (!is_measured).then_some((held_out, whole))))
        })
    }

    /// The context views of windows of photographs with measured depth, as [`DepthCases::of_photographs`].
    ///
    /// # Errors
    /// As [`DepthCases::of_photographs`], or if a view has no measured depth.
    pub fn measured(
        plans: &[Plan],
        cache: &Path,
        on_window: &(dyn Fn(&str, Option<&depth_backbone::Error>) + Sync),
    ) -> Result<Self> {
        Self::opened(plans, cache, on_window, |plan| Ok(described(plan.load(false)?, None)))
    }

    /// What `item` says of each.
    fn opened<'a, T: Sync>(
        items: &'a [T],
        cache: &Path,
        on_item: &(dyn Fn(&str, Option<&depth_backbone::Error>) + Sync),
        item: impl Fn(&'a T) -> Result<Described<'a>> + Sync,
    ) -> Result<Self> {
        let made: Vec<(String, String, Option<Vec<Item>>)> = items
            .par_iter()
            .map(|source| {
                let Described { name, key, held_out, make, pack } = item(source)?;
                let key = hexadecimal(&Sha256::digest(key));
                let file = format!("{}-{}.depth.safetensors", name.replace('/', "-"), &key[..16]);
                let made = kept_or_made(&cache.join(file), make)?;
                on_item(&name, made.as_ref().err());
                Ok((name, key + &held_out, made.ok().map(pack)))
            })
            .collect::<Result<_>>()?;
        let mut all = Sha256::new();
        let (mut items, mut scenes): (Vec<Item>, Vec<(String, Range<usize>)>) = (Vec::new(), Vec::new());
        for (name, key, made) in made {
            all.update(format!("{key} {}\n", made.is_some()));
            let begin = items.len();
            items.extend(made.into_iter().flatten());
            match scenes.last_mut() {
                Some((scene, of_scene)) if scene == scene_of(&name) => of_scene.end = items.len(),
                _ if items.len() > begin => scenes.push((scene_of(&name).to_owned(), begin..items.len())),
                _ => {}
            }
        }
        if items.is_empty() {
            return Err(Error::NoWindows);
        }
        let sources = Sources::one(scenes.into_iter().map(|(_, items)| items).collect());
        Ok(Self { items, sources, hash: hexadecimal(&all.finalize()) })
    }

    /// These and `others`, of which a `share` is drawn.
    ///
    /// # Panics
    /// If the share is not above 0 and below 1.
    #[must_use]
    pub fn mixed_with(mut self, others: Self, share: f64) -> Self {
        self.sources.mix(self.items.len(), others.sources, share);
        self.items.extend(others.items);
        let all = format!("{}\n{}\n{share}", self.hash, others.hash);
        self.hash = hexadecimal(&Sha256::digest(all));
        self
    }

    /// All views.
    pub(crate) fn views(&self) -> Vec<&DepthCase> {
        fn of(item: &Item) -> &[DepthCase] {
            match item {
                Item::View(case) => std::slice::from_ref(case),
                Item::Window(window) => &window.cases,
            }
        }
        self.items.iter().flat_map(of).collect()
    }

    /// Number of views.
    #[must_use]
    pub fn len(&self) -> usize {
        self.views().len()
    }

    /// Whether there are none; never.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    /// One window of photographs whose depth nobody measured.
    #[cfg(test)]
    pub(crate) fn of_window(window: &Window) -> Self {
        let bare = |view: &View| View::new(view.name(), view.image().clone(), *view.camera(), None).unwrap();
        let context: Vec<View> = window.context.iter().map(bare).collect();
        let held_out: Vec<View> = window.targets.iter().map(bare).collect();
        let bare = Window { context, targets: Vec::new(), ..window.clone() };
        let Described { make, pack, .. } = described(bare, Some((held_out, String::new())));
        let items = pack(make().unwrap().unwrap());
        let whole = 0..items.len();
        Self { items, sources: Sources::one([whole].into()), hash: String::new() }
    }

    /// SHA-256 of what decides the content of all of them.
    #[must_use]
    pub fn sha256(&self) -> &str {
        &self.hash
    }
}

/// The views in a file of the cache; if there is none, they are made and written.
fn kept_or_made(path: &Path, make: impl FnOnce() -> Result<Made>) -> Result<Made> {
    let fault = |source| Error::CacheFile { path: path.to_path_buf(), source };
    if path.exists() {
        let (header, kept): (Vec<KeptView>, Kept) = Kept::read(path, KIND).map_err(fault)?;
        let views = header.into_iter().enumerate().map(|(i, view)| DepthCase::read(&kept, i, view));
        return Ok(Ok(views.collect::<Result<_, KeptFault>>().map_err(fault)?));
    }
    let cases = match make()? {
        Ok(cases) => cases,
        Err(why) => return Ok(Err(why)),
    };
    let header: Vec<KeptView> =
        cases.iter().map(|case| KeptView { size: case.size, unit: case.unit }).collect();
    let tensors: Vec<KeptTensor> = cases.iter().enumerate().flat_map(|(i, case)| case.tensors(i)).collect();
    write_kept(path, KIND, &header, &tensors).map_err(fault)?;
    Ok(Ok(cases))
}

/// The views of a generated scene, whose depth is exact.
fn simulated(scene: SimulatedScene, size: (usize, usize)) -> Result<Made> {
    let views = simulated_context(scene, size, SAMPLES)?;
    let case = |(inputs, view): (&Inputs, &View)| {
        let depth = view.depth().expect("simulated views have depth");
        DepthCase::new(inputs, depth.data().iter().copied(), f32::NAN)
    };
    Ok(PlaneSweep::default().inputs(&views).map(|inputs| inputs.iter().zip(&views).map(case).collect()))
}

/// A window of photographs; with `held_out` photographs, and the hash of the window with them, it is drawn as a whole, and no depth was measured.
fn described(window: Window, held_out: Option<(Vec<View>, String)>) -> Described<'static> {
    let key = format!("{VERSION} {}", window.exact_sha256());
    let name = window.name.clone();
    let Some((held_out, whole)) = held_out else {
        let make = Box::new(move || measured(&window));
        return Described { name, key, held_out: String::new(), make, pack: Box::new(single) };
    };
    let context = window.context.clone();
    let make = Box::new(move || without_truth(&window));
    let pack = move |cases| vec![Item::Window(DepthWindow { cases, context, held_out })];
    Described { name, key, held_out: whole, make, pack: Box::new(pack) }
}

/// The context views of a window of photographs, whose depth is measured.
fn measured(window: &Window) -> Result<Made> {
    let measured: Vec<&[f32]> = window
        .context
        .iter()
        .map(|view| {
            let depth = view.depth().map(DepthMap::data);
            depth.ok_or_else(|| Error::NoMeasuredDepth {
                window: window.name.clone(),
                view: view.name().into(),
            })
        })
        .collect::<Result<_>>()?;
    let case = |(inputs, depth): (&Inputs, &&[f32])| DepthCase::new(inputs, depth.iter().copied(), UNKNOWN);
    let inputs = PlaneSweep::default().inputs(&window.context);
    Ok(inputs.map(|inputs| inputs.iter().zip(&measured).map(case).collect()))
}

/// The same without measured depth.
fn without_truth(window: &Window) -> Result<Made> {
    let case = |inputs: &Inputs| {
        let (width, height) = inputs.size();
        DepthCase::new(inputs, std::iter::repeat_n(0.0, width * height), UNKNOWN)
    };
    let inputs = PlaneSweep::default().inputs(&window.context);
    Ok(inputs.map(|inputs| inputs.iter().map(case).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use scene_sim::Kind;
    use scene_windows::simulated_window;

    #[test]
    fn measured_depth_is_the_truth_where_there_is_some() {
        let mut window = simulated_window(SimulatedScene::Generated(Kind::Desk, 3), (120, 80)).unwrap();
        let exact: Vec<Vec<f32>> =
            window.context.iter().map(|view| view.depth().unwrap().data().to_vec()).collect();
        for (view, exact) in window.context.iter_mut().zip(&exact) {
            let measured = exact.iter().enumerate().map(|(i, &z)| if i % 3 == 0 { 0.0 } else { z }).collect();
            let depth = DepthMap::new(120, 80, measured).unwrap();
            *view = View::new(view.name(), view.image().clone(), *view.camera(), Some(depth)).unwrap();
        }
        let cases = measured(&window).unwrap().unwrap();
        for (case, exact) in cases.iter().zip(&exact) {
            for (i, (z, exact)) in case.whole().exact_depth().iter().zip(exact).enumerate() {
                let far = 1.0 / case.unit[0];
                let expected = exact.min(far);
                assert!(
                    if i % 3 == 0 { z.is_nan() } else { (z - expected).abs() < 1e-3 * expected },
                    "{i}: {z} {exact}"
                );
            }
        }
        let last = &mut window.context[5];
        *last = View::new("last", last.image().clone(), *last.camera(), None).unwrap();
        let Err(Error::NoMeasuredDepth { view, .. }) = measured(&window) else { panic!("no error") };
        assert_eq!(view, "last");
    }
}
