use crate::features::LookUp;
use crate::lift::{CHUNK, Lift, Lifted, Place, lift, split};
use crate::normals::{NormalFit, Surface};
use crate::views::{Dropped, ViewPixels, check, count_dropped, is_kept};
use crate::{Error, Result};
use cpu_kernels::{Isa, compiled_for};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// What to compute.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Pixels with a z-depth beyond this are dropped, scene units; infinity for no limit.
    pub far: f32,
    /// How normals are fitted; `None` for no normals.
    pub normals: Option<NormalFit>,
}

impl Default for Settings {
    /// No limit, normals by [`NormalFit::default`].
    fn default() -> Self {
        Self { far: f32::INFINITY, normals: Some(NormalFit::default()) }
    }
}

/// Oriented points in the world, one per chosen pixel (the paper's anchor point cloud, section 3.2), in the order of views and
/// of their pixels. All arrays have the same length, or are empty where it says so.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Anchors {
    /// Positions, world axes, scene units. f64, for what is far from the origin: see [`Anchors::positions_from`].
    pub positions: Vec<[f64; 3]>,
    /// Unit surface normals, world axes, towards the camera; empty if none were wanted.
    pub normals: Vec<[f32; 3]>,
    /// Unit viewing directions from the camera to the point, world axes.
    pub rays: Vec<[f32; 3]>,
    /// z-depths, scene units.
    pub depths: Vec<f32>,
    /// Width of one pixel at that depth, scene units: z / √(fx fy).
    pub footprints: Vec<f32>,
    /// Colour of the pixel, in the range of the image; empty without images.
    pub colours: Vec<[f32; 3]>,
    /// Features, `[n, channels]`, bilinear at the pixel's centre; empty without feature maps, for the caller to fill in.
    pub features: Vec<f32>,
    /// Features per anchor; 0 while there are none.
    pub channels: usize,
    /// Index (row-major) of the pixel in its view.
    pub pixels: Vec<u32>,
    /// Index of the view.
    pub views: Vec<u32>,
}

impl Anchors {
    /// Number of anchors.
    #[must_use]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Positions as seen from `origin`, world axes, rounded to f32 once: the error is 6e-8 of the distance to `origin`.
    #[must_use]
    pub fn positions_from(&self, origin: DVec3) -> Vec<[f32; 3]> {
        self.positions.iter().map(|&p| (DVec3::from(p) - origin).as_vec3().to_array()).collect()
    }
}

/// Anchors of several views, and what became of each view's pixels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Backprojected {
    /// The anchors.
    pub anchors: Anchors,
    /// Which of them belong to each view.
    pub ranges: Vec<Range<usize>>,
    /// How many pixels of each view gave none, and why. Which: those that [`Anchors::pixels`] lacks.
    pub dropped: Vec<Dropped>,
}

impl Backprojected {
    /// Puts the anchors of further views behind these. Both have the same arrays filled.
    ///
    /// # Panics
    /// If they differ in their number of features.
    pub fn append(&mut self, others: Self) {
        let (first, first_view) = (self.anchors.len(), self.ranges.len() as u32);
        let (own_anchors, others_anchors) = (&mut self.anchors, others.anchors);
        if self.ranges.is_empty() {
            *own_anchors = others_anchors;
        } else {
            assert_eq!(own_anchors.channels, others_anchors.channels, "features per anchor");
            own_anchors.positions.extend(others_anchors.positions);
            own_anchors.normals.extend(others_anchors.normals);
            own_anchors.rays.extend(others_anchors.rays);
            own_anchors.depths.extend(others_anchors.depths);
            own_anchors.footprints.extend(others_anchors.footprints);
            own_anchors.colours.extend(others_anchors.colours);
            own_anchors.features.extend(others_anchors.features);
            own_anchors.pixels.extend(others_anchors.pixels);
            own_anchors.views.extend(others_anchors.views.into_iter().map(|view| first_view + view));
        }
        self.ranges.extend(others.ranges.into_iter().map(|range| first + range.start..first + range.end));
        self.dropped.extend(others.dropped);
    }
}

/// Lifts the chosen pixels of all views into the world: the centre of each pixel at its z-depth.
///
/// # Errors
/// If a size does not fit its camera, a pixel lies outside its view, some views have images or features and others do not,
/// or a setting is out of range. A depth is never an error: see [`Dropped`].
pub fn anchors(views: &[ViewPixels], settings: &Settings) -> Result<Backprojected> {
    let &Settings { far, normals } = settings;
    if far.is_nan() || far <= 0.0 {
        return Err(Error::Far { found: far });
    }
    normals.map_or(Ok(()), NormalFit::check)?;
    check(views)?;

    let chunks: Vec<(usize, &[u32])> = views
        .iter()
        .enumerate()
        .flat_map(|(i, view)| view.pixels.chunks(CHUNK).map(move |c| (i, c)))
        .collect();
    let count = |&(view, pixels): &(usize, &[u32])| {
        let depth = views[view].depth;
        count_dropped(pixels, depth, far).map_err(|pixel| Error::PixelOutside {
            view,
            pixel,
            pixels: depth.len(),
        })
    };
    // The first error in order, whichever thread finds one first.
    let counted: Vec<Result<Dropped>> = chunks.par_iter().map(count).collect();
    let dropped_of: Vec<Dropped> = counted.into_iter().collect::<Result<_>>()?;
    let mut dropped = vec![Dropped::default(); views.len()];
    chunks.iter().zip(&dropped_of).for_each(|(&(view, _), &part)| dropped[view] += part);
    let mut ranges: Vec<Range<usize>> = Vec::with_capacity(views.len());
    for (view, dropped) in views.iter().zip(&dropped) {
        let first = ranges.last().map_or(0, |range| range.end);
        ranges.push(first..first + view.pixels.len() - dropped.total());
    }

    let n = ranges.last().map_or(0, |range| range.end);
    let channels = views.first().and_then(|view| view.features).map_or(0, gs_scene::FeatureMap::channels);
    let coloured = views.first().is_some_and(|view| view.image.is_some());
    let mut anchors = Anchors {
        positions: vec![[0.0; 3]; n],
        normals: vec![[0.0; 3]; if normals.is_some() { n } else { 0 }],
        rays: vec![[0.0; 3]; n],
        depths: vec![0.0; n],
        footprints: vec![0.0; n],
        colours: vec![[0.0; 3]; if coloured { n } else { 0 }],
        features: zeros(n * channels),
        channels,
        pixels: vec![0; n],
        views: vec![0; n],
    };
    let mut rest = Slots::all(&mut anchors);
    let tasks: Vec<_> = chunks
        .iter()
        .zip(&dropped_of)
        .map(|(&(view, pixels), dropped)| (view, pixels, rest.split_off(pixels.len() - dropped.total())))
        .collect();
    let isa = Isa::in_use();
    let sources: Vec<Source> = views.iter().map(|view| Source::new(view, settings)).collect();
    tasks.into_par_iter().for_each(|(view, pixels, slots)| {
        slots.views.fill(view as u32);
        sources[view].fill(isa, pixels, slots);
    });
    Ok(Backprojected { anchors, ranges, dropped })
}

/// Zeros by all threads: of what is computed here, features are most of the memory.
fn zeros(n: usize) -> Vec<f32> {
    const BLOCK: usize = 1024;
    let blocks: Vec<[f32; BLOCK]> = rayon::iter::repeat_n([0.0; BLOCK], n.div_ceil(BLOCK)).collect();
    let mut zeros = blocks.into_flattened();
    zeros.truncate(n);
    zeros
}

/// The part of the arrays that a task fills.
struct Slots<'a> {
    positions: &'a mut [[f64; 3]],
    normals: &'a mut [[f32; 3]],
    rays: &'a mut [[f32; 3]],
    depths: &'a mut [f32],
    footprints: &'a mut [f32],
    colours: &'a mut [[f32; 3]],
    features: &'a mut [f32],
    channels: usize,
    pixels: &'a mut [u32],
    views: &'a mut [u32],
}

/// The first `n` of what is left, or nothing where nothing is wanted.
fn take<'a, T>(slice: &mut &'a mut [T], n: usize) -> &'a mut [T] {
    let n = n.min(slice.len());
    slice.split_off_mut(..n).unwrap_or_default()
}

impl<'a> Slots<'a> {
    fn all(anchors: &'a mut Anchors) -> Self {
        Self {
            positions: &mut anchors.positions,
            normals: &mut anchors.normals,
            rays: &mut anchors.rays,
            depths: &mut anchors.depths,
            footprints: &mut anchors.footprints,
            colours: &mut anchors.colours,
            features: &mut anchors.features,
            channels: anchors.channels,
            pixels: &mut anchors.pixels,
            views: &mut anchors.views,
        }
    }

    /// The slots of the next `n` anchors.
    fn split_off(&mut self, n: usize) -> Self {
        Self {
            positions: take(&mut self.positions, n),
            normals: take(&mut self.normals, n),
            rays: take(&mut self.rays, n),
            depths: take(&mut self.depths, n),
            footprints: take(&mut self.footprints, n),
            colours: take(&mut self.colours, n),
            features: take(&mut self.features, n * self.channels),
            channels: self.channels,
            pixels: take(&mut self.pixels, n),
            views: take(&mut self.views, n),
        }
    }
}

/// A view, ready to be looked up.
struct Source<'a> {
    view: &'a ViewPixels<'a>,
    far: f32,
    lift: Lift,
    surface: Option<Surface<'a>>,
    features: Option<LookUp<'a>>,
}

impl<'a> Source<'a> {
    fn new(view: &'a ViewPixels<'a>, settings: &Settings) -> Self {
        let &ViewPixels { camera, depth, features, .. } = view;
        Self {
            view,
            far: settings.far,
            lift: Lift::new(camera),
            surface: settings.normals.map(|fit| Surface::new(camera, depth, fit)),
            features: features.map(|map| LookUp::new(map, camera.width(), camera.height())),
        }
    }

    /// Fills the slots from at most [`CHUNK`] chosen pixels, of which as many are kept as there are slots.
    fn fill(&self, isa: Isa, chosen: &[u32], slots: Slots) {
        let Slots { positions, normals, rays, depths, footprints, colours, features, pixels, .. } = slots;
        let depth_of = |pixel: u32| self.view.depth[pixel as usize];
        let kept = chosen.iter().filter(|&&pixel| is_kept(depth_of(pixel), self.far));
        for ((pixel, depth), &kept) in pixels.iter_mut().zip(&mut *depths).zip(kept) {
            *pixel = kept;
            *depth = depth_of(kept);
        }
        let mut buffer = [Place::default(); CHUNK];
        let places = &mut buffer[..pixels.len()];
        split(pixels, self.view.camera.width(), places);
        let lifted = Lifted { positions, rays, footprints };
        compiled_for!(isa, lift(&self.lift, places, depths, lifted));
        if let Some(surface) = &self.surface {
            surface.normals(isa, places, normals);
        }
        if let Some(image) = self.view.image {
            let rgb = image.data().as_chunks::<3>().0;
            for (colour, &pixel) in colours.iter_mut().zip(&*pixels) {
                *colour = rgb[pixel as usize];
            }
        }
        if let Some(look_up) = &self.features {
            look_up.features(isa, places, features);
        }
    }
}
