//! Frames in, one after the other.

use crate::compare::{Pixel, classify, wrong_colours};
use crate::covisibility::Footprint;
use crate::draw::{LARGEST, backdrop, draw};
use crate::fuse::{Fused, Observation, error, fuse, inverse_depths, recolour};
use crate::keyframes::{Keyframe, Keyframes};
use crate::look::Look;
use crate::map::Map;
use crate::room::make_room;
use crate::{Config, Depth, Integrated, Outcome, Refusal, Result, Seen, Update, Waiting, bootstrap, stereo};
use depth_backbone::{DepthBackbone, GivenDepth, ViewGeometry, Wanted};
use gs_raster::{PixelGradients, Rasterizer, RenderSettings, near_plane};
use gs_scene::{Camera, Gaussians, View};
use std::time::Instant;

/// A frame may be so many typical depths away from the one before; beyond, its pose is taken for wrong.
const LONGEST_STEP: f64 = 30.0;
/// Standard deviation of the luma, 8-bit levels, below which a picture shows nothing.
const CONTRAST: f64 = 1.0;
/// Relative difference up to which depths agree: measured ones …
const TOLERANCE_MEASURED: f32 = 0.03;
/// … and those of stereo.
const TOLERANCE_STEREO: f32 = 0.05;
/// Old keyframes that a refinement compares beside the new one.
const REFINED_WITH: usize = 2;
/// Step sizes of a refinement over those of the looks of a forward pass, which see every place from several views; here most places are
/// compared in one. Found in docs/journal/2026-11-stream-steps.md, as [`LARGEST`].
const REFINE_RATE: f32 = 0.45;

/// A posed frame.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Picture, camera, and measured depth if there is some.
    pub view: View,
    /// Time stamp, seconds; it may not decrease from frame to frame.
    pub time: Option<f64>,
}

impl From<View> for Frame {
    fn from(view: View) -> Self {
        Self { view, time: None }
    }
}

/// A map that grows with the frames that are pushed, up to its cap.
#[derive(Debug)]
pub struct Mapper {
    pub(crate) config: Config,
    pub(crate) map: Map,
    pub(crate) keyframes: Keyframes,
    /// First keyframes of stereo that wait for others.
    pub(crate) waiting: Vec<Keyframe>,
    /// Frames so far, refused ones counted.
    pub(crate) frames: usize,
    pub(crate) latest_time: Option<f64>,
    /// Camera of the last frame, and of the last one that was not refused.
    pub(crate) last: [Option<Camera>; 2],
    pub(crate) rasterizer: Rasterizer,
}

impl Mapper {
    /// An empty map.
    ///
    /// # Errors
    /// If a setting is out of its range.
    pub fn new(config: Config) -> Result<Self> {
        config.check()?;
        Ok(Self {
            map: Map::new(config.most())?,
            config,
            keyframes: Keyframes::default(),
            waiting: Vec::new(),
            frames: 0,
            latest_time: None,
            last: [None; 2],
            rasterizer: Rasterizer::cpu(),
        })
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The map as it is, SH degree 0, world frame.
    #[must_use]
    pub fn map(&self) -> &Gaussians {
        &self.map.gaussians
    }

    /// Bytes of the map: [`BYTES`](crate::BYTES) per Gaussian.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.map.bytes()
    }

    /// Frames so far, refused ones counted.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Keyframes so far.
    #[must_use]
    pub fn keyframes(&self) -> usize {
        self.keyframes.count
    }

    /// Counts a frame that could not be read, so that a run that goes on from a snapshot finds its place.
    pub fn skip(&mut self) {
        self.frames += 1;
    }

    /// Takes the next frame. A frame that cannot be used is refused, and changes nothing.
    ///
    /// # Errors
    /// If the map cannot be rendered or refined, or the forward pass fails. The map is usable afterwards.
    pub fn push(&mut self, frame: &Frame) -> Result<Update> {
        let begin = Instant::now();
        let index = self.frames;
        self.frames += 1;
        let outcome = match self.refusal(frame) {
            Some(refusal) => Outcome::Refused(refusal),
            None => {
                self.latest_time = frame.time.or(self.latest_time);
                self.place(&frame.view)?
            }
        };
        Ok(Update {
            frame: index,
            outcome,
            seconds: begin.elapsed().as_secs_f64(),
            gaussians: self.map.len(),
            bytes: self.map.bytes(),
        })
    }

    /// Why a frame cannot be used; remembers where it was taken.
    fn refusal(&mut self, frame: &Frame) -> Option<Refusal> {
        let view = &frame.view;
        let refusal =
            self.refusal_by_time(frame.time).or_else(|| refusal_by_content(view, self.config.depth));
        if refusal.is_some() {
            return refusal;
        }
        let camera = *view.camera();
        let near = self.last.iter().flatten().map(|last| last.position().distance(camera.position()));
        let distance = near.fold(f64::INFINITY, f64::min);
        let limit =
            self.keyframes.footprints.last().and_then(Footprint::median).map(|depth| LONGEST_STEP * depth);
        self.last[0] = Some(camera);
        if let Some(limit) = limit.filter(|&limit| distance > limit && distance.is_finite()) {
            return Some(Refusal::Jump { distance, limit });
        }
        self.last[1] = Some(camera);
        None
    }

    fn refusal_by_time(&self, time: Option<f64>) -> Option<Refusal> {
        let time = time?;
        if !time.is_finite() {
            return Some(Refusal::TimeNotFinite);
        }
        let latest = self.latest_time.filter(|&latest| time < latest)?;
        Some(Refusal::TimeBackwards { time, latest })
    }

    /// Finds out what a frame is to the map, and changes the map if it is a keyframe.
    fn place(&mut self, view: &View) -> Result<Outcome> {
        match self.config.depth {
            Depth::Measured => {
                let look = self.look(view, view.depth().map(|depth| depth.data()))?;
                if !look.is_keyframe(Depth::Measured) {
                    return Ok(Outcome::Seen(look.seen));
                }
                let views = std::slice::from_ref(view);
                let geometry = GivenDepth.estimate(views, Wanted::Depth);
                let range = GivenDepth::depth_range(views);
                match (geometry, range) {
                    (Ok(mut all), Ok(range)) => self.integrate(view, all.swap_remove(0), range, look.seen),
                    _ => Ok(Outcome::Refused(Refusal::NoDepth)),
                }
            }
            Depth::Stereo if self.keyframes.count == 0 => match bootstrap::wait(view, &mut self.waiting)? {
                Err(waiting) => Ok(Outcome::Waiting(waiting)),
                Ok((views, geometry, range)) => {
                    let mut outcome = Outcome::Waiting(Waiting::FirstKeyframes);
                    for (view, geometry) in views.iter().zip(geometry) {
                        let seen = self.look(view, None)?.seen;
                        outcome = self.integrate(view, geometry, range, seen)?;
                    }
                    Ok(outcome)
                }
            },
            Depth::Stereo => {
                let look = self.look(view, None)?;
                if !look.is_keyframe(Depth::Stereo) {
                    return Ok(Outcome::Seen(look.seen));
                }
                match stereo::depth(view, &look, &self.keyframes.kept, &self.config)? {
                    Err(waiting) => Ok(Outcome::Waiting(waiting)),
                    Ok((geometry, range)) => self.integrate(view, geometry, range, look.seen),
                }
            }
        }
    }

    fn look(&mut self, view: &View, measured: Option<&[f32]>) -> Result<Look> {
        Look::new(&self.map, &self.keyframes, view, measured, &mut self.rasterizer)
    }

    /// Joins a keyframe to the map: what it confirms or contradicts first, then what is new.
    fn integrate(
        &mut self,
        view: &View,
        geometry: ViewGeometry,
        range: (f64, f64),
        seen: Seen,
    ) -> Result<Outcome> {
        let camera = view.camera();
        let tolerance = match self.config.depth {
            Depth::Measured => TOLERANCE_MEASURED,
            Depth::Stereo => TOLERANCE_STEREO,
        };
        let had_map = self.map.len() > 0;
        let (psnr_before, fused) = self.fuse(view, &geometry, tolerance)?;
        let open = self.open(view, &geometry, tolerance)?;
        let open_share = open.iter().filter(|open| **open).count() as f64 / open.len() as f64;
        let footprint = Footprint::new(camera, geometry.depth.data());
        let most = (self.map.most / 2).max(1);
        let back = match self.config.depth {
            Depth::Measured => backdrop(view, &geometry, range, &open, &self.config, most / 4)?,
            Depth::Stereo => Gaussians::empty(0)?,
        };
        let mut new = draw(view, geometry, range, &open, &self.config, most - back.len())?;
        new.append(&back);
        let reduced = make_room(&mut self.map, new.len())?;
        self.map.append(&new, camera);
        self.recolour(view, new.len())?;
        self.keyframes.push(Keyframe::new(view, footprint), self.config.kept);
        self.refine()?;
        Ok(Outcome::Keyframe(Integrated {
            seen,
            psnr_before: had_map.then_some(psnr_before),
            open: open_share,
            drawn: new.len(),
            confirmed: fused.confirmed,
            faded: fused.faded,
            removed: fused.removed,
            merged: reduced.merged,
            evicted: reduced.evicted,
        }))
    }

    fn settings(&self, camera: &Camera) -> RenderSettings {
        let near = near_plane(&self.map.gaussians, camera);
        RenderSettings { near, depth: true, ..RenderSettings::default() }
    }

    /// Joins what a keyframe says of the Gaussians that it sees; gives the PSNR before, dB.
    fn fuse(&mut self, view: &View, geometry: &ViewGeometry, tolerance: f32) -> Result<(f64, Fused)> {
        let camera = view.camera();
        let settings = self.settings(camera);
        let (mut rendered, tape) =
            self.rasterizer.record(&self.map.gaussians, std::slice::from_ref(camera), &settings)?;
        let rendered = rendered.swap_remove(0);
        let (width, height) = (camera.width(), camera.height());
        let psnr = image_metrics::psnr_rgb(rendered.image.data(), view.image().data(), width, height);
        let psnr = psnr.unwrap_or(f64::NAN);
        if self.map.len() == 0 {
            return Ok((psnr, Fused::default()));
        }
        let depth = rendered.depth.unwrap_or_default();
        let pixels = classify(&rendered.alpha, &depth, geometry, tolerance);
        let error = error(view.image().data(), rendered.image.data(), &pixels);
        let inverse = inverse_depths(geometry, &depth);
        let gradients = [PixelGradients { image: error.into(), alpha: None, depth: None }];
        let (gradients, shares) =
            self.rasterizer.backward_with_shares(&self.map.gaussians, &tape, &gradients, &[inverse])?;
        let observation = Observation {
            camera,
            geometry,
            pixels: &pixels,
            tolerance,
            shares: &shares,
            by_colour: &gradients.sh,
        };
        Ok((psnr, fuse(&mut self.map, &observation)))
    }

    /// The pixels of a keyframe that the map does not show, or shows wrong.
    fn open(&mut self, view: &View, geometry: &ViewGeometry, tolerance: f32) -> Result<Vec<bool>> {
        let camera = view.camera();
        let settings = self.settings(camera);
        let rendered = self.rasterizer.render(&self.map.gaussians, camera, &settings)?;
        let pixels = classify(&rendered.alpha, &rendered.depth.unwrap_or_default(), geometry, tolerance);
        let error = difference(view, rendered.image.data());
        let wrong = wrong_colours(&error, camera.width());
        let is_open = |((pixel, wrong), i): ((&Pixel, bool), usize)| match pixel {
            Pixel::Thin | Pixel::Before => true,
            Pixel::Agrees => wrong && geometry.is_confirmed(i),
            Pixel::Through | Pixel::Unknown => false,
        };
        Ok(pixels.iter().zip(wrong).zip(0..).map(is_open).collect())
    }

    /// Brings the colours of the newest `count` Gaussians to what their keyframe shows where they are visible: blended with those
    /// before and behind them, they look different from the cells that they are made of.
    fn recolour(&mut self, view: &View, count: usize) -> Result<()> {
        if count == 0 {
            return Ok(());
        }
        let camera = view.camera();
        let settings = RenderSettings { depth: false, ..self.settings(camera) };
        let (rendered, tape) =
            self.rasterizer.record(&self.map.gaussians, std::slice::from_ref(camera), &settings)?;
        let image = difference(view, rendered[0].image.data());
        let zero = vec![0.0; camera.width() * camera.height()];
        let gradients = [PixelGradients { image: image.into(), alpha: None, depth: None }];
        let (gradients, shares) =
            self.rasterizer.backward_with_shares(&self.map.gaussians, &tape, &gradients, &[zero])?;
        recolour(&mut self.map, count, &shares, &gradients.sh);
        Ok(())
    }

    /// A few gradient steps on the newest keyframe and old ones.
    fn refine(&mut self) -> Result<()> {
        if self.config.refine == 0 || self.map.len() == 0 {
            return Ok(());
        }
        let kept = &self.keyframes.kept;
        let Some((newest, old)) = kept.split_last() else { return Ok(()) };
        // The old one most like it, and the others in turn.
        let similar = |i: &usize| newest.footprint.similarity(&old[*i].footprint);
        let nearest = (0..old.len()).max_by(|i, j| similar(i).total_cmp(&similar(j)).then(i.cmp(j)));
        let in_turn = (!old.is_empty()).then(|| self.keyframes.count % old.len());
        let mut chosen: Vec<usize> = nearest.into_iter().chain(in_turn).take(REFINED_WITH).collect();
        chosen.dedup();
        let mut views = vec![newest.view()?];
        for i in chosen {
            views.push(old[i].view()?);
        }
        let rounds = refine::Config::rounds(1, views.len());
        let refine::Rates { mean, rotation, scale, opacity, colour, .. } = rounds.rates;
        let [mean, rotation, scale, opacity, colour] =
            [mean, rotation, scale, opacity, colour].map(|rate| REFINE_RATE * rate);
        let config = refine::Config {
            stop: refine::Stop::Steps(self.config.refine),
            views_per_step: views.len(),
            rates: refine::Rates { mean, rotation, scale, opacity, colour, ..refine::Rates::default() },
            largest: LARGEST as f32,
            // A map takes its steps from many keyframes, one after the other, so no single one may push far.
            damping: refine::Config::default().damping,
            exposure: false,
            seed: self.config.seed ^ self.keyframes.count as u64,
            ..rounds
        };
        let refined =
            refine::refine(self.map.gaussians.clone(), &views, &config, &mut self.rasterizer, &mut |_| {})?;
        // Into the buffers that are there: they have room for the whole map.
        let (geometry, sh) = self.map.gaussians.buffers_mut();
        geometry.copy_from_slice(refined.gaussians.geometry());
        sh.copy_from_slice(refined.gaussians.sh());
        Ok(())
    }
}

/// Photograph less rendering.
fn difference(view: &View, rendered: &[f32]) -> Vec<f32> {
    view.image().data().iter().zip(rendered).map(|(a, b)| a - b).collect()
}

fn refusal_by_content(view: &View, depth: Depth) -> Option<Refusal> {
    let image = view.image();
    if let Some(i) = image.data().iter().position(|value| !value.is_finite()) {
        let pixel = i / 3;
        return Some(Refusal::PixelNotFinite { x: pixel % image.width(), y: pixel / image.width() });
    }
    if depth == Depth::Measured && view.depth().is_none_or(|depth| depth.coverage() == 0.0) {
        return Some(Refusal::NoDepth);
    }
    let luma = image.luma8();
    let mean = luma.iter().map(|&v| f64::from(v)).sum::<f64>() / luma.len() as f64;
    let variance = luma.iter().map(|&v| (f64::from(v) - mean).powi(2)).sum::<f64>() / luma.len() as f64;
    (variance < CONTRAST * CONTRAST).then_some(Refusal::NoContrast)
}
