//! COLMAP's sparse model, binary or text. Its points are samples of the frames' depth, seen wherever their projection meets the
//! same depth.

use super::samples::{CELLS, cell_of, depth_at, samples};
use super::{FrameToWrite, PosedFrame, write_file};
use crate::{Result, ScenePoint};
use glam::{DQuat, DVec2, DVec3};
use gs_scene::{Camera, Lens};
use std::fmt::Write as _;
use std::path::Path;

/// The model so far.
#[derive(Debug)]
pub(super) struct Model {
    text: bool,
    /// Distinct lenses; a camera's id is its position + 1.
    lenses: Vec<Lens>,
    images: Vec<ModelImage>,
    points: Vec<Point>,
}

#[derive(Debug)]
struct ModelImage {
    /// Relative to `images/`.
    name: String,
    lens: usize,
    camera: Camera,
    /// Where points are seen: pixel position, position in the list of points.
    seen: Vec<(DVec2, usize)>,
}

#[derive(Debug)]
struct Point {
    position: DVec3,
    colour: [u8; 3],
    /// Mean reprojection error, pixels; 0 for samples of depth.
    error: f64,
    /// Position of the image, position in its list of points.
    track: Vec<(usize, usize)>,
}

/// Points of so many frames back are looked for in a frame: the work per frame stays bounded.
const FRAMES_BACK: usize = 20;
/// A point is seen if the frame's depth at its projection is its own up to this share.
const SAME_DEPTH: f64 = 0.01;

impl Model {
    pub(super) fn new(text: bool) -> Self {
        Self { text, lenses: Vec::new(), images: Vec::new(), points: Vec::new() }
    }

    /// Frames whose pictures lie there already, and their points.
    pub(super) fn of_posed(frames: &[PosedFrame], points: &[ScenePoint]) -> Self {
        let mut model = Self::new(false);
        for frame in frames {
            let (name, lens) = (frame.picture.clone(), model.lens(&frame.lens));
            model.images.push(ModelImage { name, lens, camera: frame.camera, seen: Vec::new() });
        }
        for (index, point) in points.iter().enumerate() {
            let mut track = Vec::with_capacity(point.observations.len());
            for observation in &point.observations {
                let seen = &mut model.images[observation.frame].seen;
                track.push((observation.frame, seen.len()));
                seen.push((observation.pixel, index));
            }
            let (colour, error) = (point.colour.unwrap_or([128; 3]), point.error.unwrap_or(0.0));
            model.points.push(Point { position: point.position, colour, error, track });
        }
        model
    }

    /// Position of a lens in the list, where it is put if it is new.
    fn lens(&mut self, lens: &Lens) -> usize {
        self.lenses.iter().position(|other| other == lens).unwrap_or_else(|| {
            self.lenses.push(*lens);
            self.lenses.len() - 1
        })
    }

    pub(super) fn add(&mut self, frame: &FrameToWrite<'_>) -> Result<u64> {
        let path = frame.write_picture()?;
        let lens = self.lens(frame.lens);
        let name = path.trim_start_matches("images/").to_owned();
        let mut image = ModelImage { name, lens, camera: *frame.view.camera(), seen: Vec::new() };
        let mut taken = [false; CELLS * CELLS];
        let oldest = self.images.len().saturating_sub(FRAMES_BACK);
        for (index, point) in self.points.iter_mut().enumerate() {
            if point.track[0].0 < oldest {
                continue;
            }
            if let Some(pixel) = sees(frame, point.position) {
                taken[cell_of(pixel, frame.lens)] = true;
                point.track.push((frame.index, image.seen.len()));
                image.seen.push((pixel, index));
            }
        }
        for (cell, sample) in samples(frame.view, frame.lens) {
            if !taken[cell] {
                let track = vec![(frame.index, image.seen.len())];
                image.seen.push((sample.pixel, self.points.len()));
                self.points.push(Point {
                    position: sample.position,
                    colour: sample.colour,
                    error: 0.0,
                    track,
                });
            }
        }
        self.images.push(image);
        Ok(0)
    }

    pub(super) fn finish(&self, folder: &Path) -> Result<()> {
        let folder = folder.join("sparse/0");
        let files = if self.text {
            [
                ("cameras.txt", self.cameras_txt()),
                ("images.txt", self.images_txt()),
                ("points3D.txt", self.points_txt()),
            ]
            .map(|(name, text)| (name, text.into_bytes()))
        } else {
            [
                ("cameras.bin", self.cameras_bin()),
                ("images.bin", self.images_bin()),
                ("points3D.bin", self.points_bin()),
            ]
        };
        files.iter().try_for_each(|(name, bytes)| write_file(&folder.join(name), bytes))
    }

    /// Whether a point is in the model: one that a single image sees could not have been triangulated.
    fn is_kept(&self, point: usize) -> bool {
        self.points[point].track.len() > 1
    }

    fn kept_points(&self) -> impl Iterator<Item = (usize, &Point)> {
        self.points.iter().enumerate().filter(|(index, _)| self.is_kept(*index))
    }

    fn cameras_bin(&self) -> Vec<u8> {
        let mut out = Bytes::default();
        out.count(self.lenses.len());
        for (index, lens) in self.lenses.iter().enumerate() {
            let (model, parameters) = parameters(lens);
            out.u32(id(index)).u32(model.number);
            out.count(lens.intrinsics.width).count(lens.intrinsics.height);
            parameters.iter().for_each(|value| out.f64(*value));
        }
        out.0
    }

    fn images_bin(&self) -> Vec<u8> {
        let mut out = Bytes::default();
        out.count(self.images.len());
        for (index, image) in self.images.iter().enumerate() {
            out.u32(id(index));
            pose(&image.camera).iter().for_each(|value| out.f64(*value));
            out.u32(id(image.lens));
            out.0.extend_from_slice(image.name.as_bytes());
            out.0.push(0);
            out.count(image.seen.len());
            for (pixel, point) in &image.seen {
                out.f64(pixel.x);
                out.f64(pixel.y);
                // COLMAP's mark of a feature without a point.
                out.u64(if self.is_kept(*point) { u64::from(id(*point)) } else { u64::MAX });
            }
        }
        out.0
    }

    fn points_bin(&self) -> Vec<u8> {
        let mut out = Bytes::default();
        out.count(self.kept_points().count());
        for (index, point) in self.kept_points() {
            out.u64(u64::from(id(index)));
            point.position.to_array().iter().for_each(|value| out.f64(*value));
            out.0.extend_from_slice(&point.colour);
            out.f64(point.error);
            out.count(point.track.len());
            for (image, place) in &point.track {
                out.u32(id(*image)).u32(*place as u32);
            }
        }
        out.0
    }

    fn cameras_txt(&self) -> String {
        let mut text = String::from("# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n");
        for (index, lens) in self.lenses.iter().enumerate() {
            let (model, parameters) = parameters(lens);
            let (width, height) = (lens.intrinsics.width, lens.intrinsics.height);
            line(&mut text, format_args!("{} {} {width} {height}", id(index), model.name), &parameters);
        }
        text
    }

    fn images_txt(&self) -> String {
        let mut text = String::from("# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME\n# (X Y POINT3D_ID)[]\n");
        for (index, image) in self.images.iter().enumerate() {
            let pose = words(&pose(&image.camera));
            let seen: Vec<String> = image
                .seen
                .iter()
                .map(|(pixel, point)| {
                    let point = if self.is_kept(*point) { i64::from(id(*point)) } else { -1 };
                    format!("{} {} {point}", pixel.x, pixel.y)
                })
                .collect();
            let (id, camera, name) = (id(index), id(image.lens), &image.name);
            writeln!(text, "{id} {pose} {camera} {name}\n{}", seen.join(" ")).expect("a String takes all");
        }
        text
    }

    fn points_txt(&self) -> String {
        let mut text = String::from("# POINT3D_ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX)[]\n");
        for (index, point) in self.kept_points() {
            let [r, g, b] = point.colour;
            let track = point.track.iter().map(|(image, place)| format!("{} {place}", id(*image)));
            let (position, track) = (words(&point.position.to_array()), track.collect::<Vec<_>>().join(" "));
            writeln!(text, "{} {position} {r} {g} {b} {} {track}", id(index), point.error)
                .expect("a String takes all");
        }
        text
    }
}

/// Where a frame sees a point, if nothing hides it.
fn sees(frame: &FrameToWrite<'_>, position: DVec3) -> Option<DVec2> {
    let seen = frame.view.camera().to_camera(position);
    let depth = frame.view.depth()?;
    if seen.z <= 0.0 {
        return None;
    }
    let pixel = frame.lens.distort(seen.truncate() / seen.z);
    let inside = pixel.cmpge(DVec2::ZERO).all()
        && pixel.x < depth.width() as f64
        && pixel.y < depth.height() as f64
        // Far outside the picture distortion may fold back into it.
        && (frame.lens.undistort(pixel)? - seen.truncate() / seen.z).length() < 1e-6;
    let found = if inside { depth_at(depth, pixel.x as usize, pixel.y as usize)? } else { return None };
    ((found - seen.z).abs() <= SAME_DEPTH * seen.z).then_some(pixel)
}

/// World-to-camera: quaternion w x y z, translation.
fn pose(camera: &Camera) -> [f64; 7] {
    let q = DQuat::from_mat3(&camera.rotation()).normalize();
    let q = if q.w < 0.0 { -q } else { q };
    let t = camera.translation();
    [q.w, q.x, q.y, q.z, t.x, t.y, t.z]
}

/// A camera model of COLMAP's.
struct CameraModel {
    number: u32,
    name: &'static str,
}

/// The simplest model that holds a lens, and its parameters.
fn parameters(lens: &Lens) -> (CameraModel, Vec<f64>) {
    let (i, d) = (&lens.intrinsics, lens.model.radial_tangential().expect("other models were refused"));
    let mut values = vec![i.fx, i.fy, i.cx, i.cy];
    if d.is_zero() {
        return (CameraModel { number: 1, name: "PINHOLE" }, values);
    }
    values.extend([d.k1, d.k2, d.p1, d.p2]);
    if d.k3 == 0.0 {
        return (CameraModel { number: 4, name: "OPENCV" }, values);
    }
    values.extend([d.k3, 0.0, 0.0, 0.0]);
    (CameraModel { number: 6, name: "FULL_OPENCV" }, values)
}

/// Ids count from 1.
fn id(index: usize) -> u32 {
    u32::try_from(index + 1).expect("fewer than 2^32 frames and points")
}

fn words(values: &[f64]) -> String {
    values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}

fn line(text: &mut String, begin: std::fmt::Arguments<'_>, values: &[f64]) {
    writeln!(text, "{begin} {}", words(values)).expect("a String takes all");
}

/// Little-endian bytes.
#[derive(Default)]
struct Bytes(Vec<u8>);

impl Bytes {
    fn u32(&mut self, value: u32) -> &mut Self {
        self.0.extend_from_slice(&value.to_le_bytes());
        self
    }

    fn u64(&mut self, value: u64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn count(&mut self, value: usize) -> &mut Self {
        self.u64(value as u64);
        self
    }

    fn f64(&mut self, value: f64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }
}
