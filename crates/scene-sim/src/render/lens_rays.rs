//! The rays of a real camera: its lens distorts and blurs, and it moves while the shutter is open.

use super::RayCounts;
use super::beam::Beam;
use super::draws::{Draws, Purpose};
use super::rays::{CameraRays, Pose, strata};
use crate::trace::{PathRay, Traced, on_disc};
use crate::{Aperture, Error, Photographs, Result};
use glam::{DVec2, DVec3};
use gs_scene::{Intrinsics, Lens};
use rayon::prelude::*;

/// Poses per open time of the shutter: the steps between them are below a pixel for any blur that shows something.
const MOMENTS: f64 = 256.0;
/// At most so many poses for a picture, however short the open time is against the time of the rows.
const MOST_MOMENTS: f64 = 65_536.0;

/// The rays of one photograph. What is `None` is not simulated.
pub(super) struct LensRays {
    intrinsics: Intrinsics,
    bent: Option<Bent>,
    aperture: Option<Aperture>,
    /// One for each row, or one for all.
    rows: Vec<Pose>,
    open: Option<Open>,
    strata: [u32; 2],
}

/// Directions through the distortion.
struct Bent {
    /// At the corners of the pixels, (width + 1) x (height + 1).
    corners: Vec<DVec2>,
    /// At their centres.
    centres: Vec<DVec2>,
}

/// The poses while the picture is taken.
struct Open {
    /// At equal intervals from the first moment of the first row to the last one of the last.
    poses: Vec<Pose>,
    /// Open time, as a share of that time.
    share: f64,
}

/// Whether a photograph of this kind is one of a plain camera.
pub(super) fn is_plain(photographs: &Photographs) -> bool {
    let Photographs { distortion, aperture, motion_blur, rolling_shutter, .. } = photographs;
    distortion.is_none_or(|distortion| distortion.is_zero())
        && aperture.is_none_or(|aperture| aperture.diameter == 0.0)
        && motion_blur.unwrap_or(0.0) == 0.0
        && rolling_shutter.unwrap_or(0.0) == 0.0
}

impl LensRays {
    pub(super) fn new(scene: &Traced, photographs: &Photographs, index: usize) -> Result<Self> {
        let lens = photographs.lens();
        let intrinsics = lens.intrinsics;
        // In intervals between two pictures, from the middle of the open time of the middle row.
        let pose = |time: f64| -> Result<Pose> {
            let u = photographs.u(index) + time * photographs.interval();
            Ok(Pose::new(scene, &photographs.path.camera_at(intrinsics, u.clamp(0.0, 1.0))?))
        };
        let rolling = photographs.rolling_shutter.unwrap_or(0.0);
        let rows = if rolling > 0.0 { intrinsics.height } else { 1 };
        let row_time = |row: usize| rolling * ((row as f64 + 0.5) / rows as f64 - 0.5);
        let rows = (0..rows).map(|row| pose(row_time(row))).collect::<Result<_>>()?;
        let open = photographs.motion_blur.filter(|blur| *blur > 0.0).map(|blur| {
            let whole = rolling + blur;
            let count = (MOMENTS * whole / blur).ceil().min(MOST_MOMENTS);
            let poses = (0..count as u32).map(|k| pose(whole * ((f64::from(k) + 0.5) / count - 0.5)));
            Ok::<_, Error>(Open { poses: poses.collect::<Result<_>>()?, share: blur / whole })
        });
        Ok(Self {
            intrinsics,
            bent: (!lens.model.is_pinhole()).then(|| Bent::new(&lens)).transpose()?,
            aperture: photographs.aperture.filter(|aperture| aperture.diameter > 0.0),
            rows,
            open: open.transpose()?,
            strata: strata(photographs.samples),
        })
    }

    fn pose_of_row(&self, y: usize) -> &Pose {
        &self.rows[if self.rows.len() > 1 { y } else { 0 }]
    }

    /// The pose at a moment, 0..1 of the open time of a row.
    fn pose_at<'a>(&self, open: &'a Open, y: usize, moment: f64) -> &'a Pose {
        let row = (y as f64 + 0.5) / self.intrinsics.height as f64;
        let time = if self.rows.len() > 1 { row * (1.0 - open.share) } else { 0.0 } + moment * open.share;
        let index = (time * open.poses.len() as f64) as usize;
        &open.poses[index.min(open.poses.len() - 1)]
    }
}

impl Bent {
    fn new(lens: &Lens) -> Result<Self> {
        let (width, height) = (lens.intrinsics.width, lens.intrinsics.height);
        let directions = |columns: usize, rows: usize, offset: f64| {
            (0..columns * rows)
                .into_par_iter()
                .map(|i| {
                    let pixel = DVec2::new((i % columns) as f64, (i / columns) as f64) + offset;
                    lens.undistort(pixel).ok_or(Error::Folded { x: pixel.x, y: pixel.y })
                })
                .collect::<Result<Vec<DVec2>>>()
        };
        Ok(Self {
            corners: directions(width + 1, height + 1, 0.0)?,
            centres: directions(width, height, 0.5)?,
        })
    }

    /// The direction of a place `within` a pixel, and its differences per pixel. Between the corners of a pixel it is
    /// bilinear, which is off by less than a thousandth of a pixel.
    fn direction(&self, [x, y]: [usize; 2], width: usize, within: DVec2) -> (DVec2, [DVec2; 2]) {
        let corner = |dx, dy| self.corners[(y + dy) * (width + 1) + x + dx];
        let top = corner(0, 0).lerp(corner(1, 0), within.x);
        let bottom = corner(0, 1).lerp(corner(1, 1), within.x);
        (top.lerp(bottom, within.y), [corner(1, 0) - corner(0, 0), corner(0, 1) - corner(0, 0)])
    }
}

impl CameraRays for LensRays {
    fn depth(&self, x: usize, y: usize) -> PathRay {
        let pose = self.pose_of_row(y);
        let direction = match &self.bent {
            Some(bent) => bent.centres[y * self.intrinsics.width + x].extend(1.0),
            None => self.intrinsics.ray(DVec2::new(x as f64 + 0.5, y as f64 + 0.5)),
        };
        PathRay { origin: pose.origin, direction: pose.to_world * direction }
    }

    fn colour(&self, pixel: [usize; 2], within: DVec2, draws: &Draws, counts: &mut RayCounts) -> Beam {
        let [x, y] = pixel;
        let pose = match &self.open {
            None => self.pose_of_row(y),
            Some(open) => {
                counts.moments += 1;
                self.pose_at(open, y, draws.point(Purpose::Moment).x)
            }
        };
        let (direction, steps) = match &self.bent {
            Some(bent) => {
                let (direction, steps) = bent.direction(pixel, self.intrinsics.width, within);
                let [across, down] = steps.map(|step| pose.to_world * step.extend(0.0));
                let [columns, rows] = self.strata.map(f64::from);
                (direction.extend(1.0), [across / columns, down / rows])
            }
            None => {
                let place = DVec2::new(x as f64, y as f64) + within;
                (self.intrinsics.ray(place), pose.steps(&self.intrinsics, self.strata))
            }
        };
        let (mut origin, mut direction) = (pose.origin, direction);
        if let Some(aperture) = &self.aperture {
            counts.lens_points += 1;
            // Rays through any point of the opening meet where the one through its middle meets the focal plane.
            let place = (on_disc(draws.point(Purpose::Aperture)) * (0.5 * aperture.diameter)).extend(0.0);
            direction -= place / aperture.focus;
            origin += pose.to_world * place;
        }
        let ray = PathRay { origin, direction: pose.to_world * direction };
        Beam { ray, from: [DVec3::ZERO; 2], towards: steps }
    }

    fn prepared(&self) -> RayCounts {
        let distorted = self.bent.as_ref().map_or(0, |bent| bent.corners.len() + bent.centres.len());
        let rows = if self.rows.len() > 1 { self.rows.len() } else { 0 };
        RayCounts { distorted: distorted as u64, row_poses: rows as u64, ..RayCounts::default() }
    }
}
