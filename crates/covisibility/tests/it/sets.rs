use covisibility::Anchors;
use glam::{DMat3, DVec2, DVec3, EulerRot};
use gs_scene::{Camera, Intrinsics};

/// Anchors that own their arrays, and their cameras.
#[derive(Debug, Default)]
pub(crate) struct Set {
    pub(crate) cameras: Vec<Camera>,
    pub(crate) positions: Vec<[f64; 3]>,
    pub(crate) views: Vec<u32>,
    pub(crate) pixels: Vec<u32>,
    pub(crate) depths: Vec<f32>,
}

pub(crate) const SHAPES: [&str; 7] =
    ["arc", "inside", "opposite", "lattice", "one pixel", "far", "contradictory"];

/// Numbers that depend on a seed alone.
pub(crate) struct Draw(pub(crate) u64);

impl Draw {
    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(crate) fn below(&mut self, n: usize) -> usize {
        (self.bits() % n as u64) as usize
    }

    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn point(&mut self, size: f64) -> DVec3 {
        DVec3::from([0; 3].map(|_| self.within(-size, size)))
    }
}

impl Set {
    pub(crate) fn anchors(&self) -> Anchors<'_> {
        let Self { positions, views, pixels, depths, .. } = self;
        Anchors { positions, views, pixels, depths }
    }

    /// An anchor in the centre of its pixel.
    pub(crate) fn lift(&mut self, view: usize, pixel: usize, depth: f32) {
        let camera = &self.cameras[view];
        let (x, y) = (pixel % camera.width(), pixel / camera.width());
        let position = camera.unproject(DVec2::new(x as f64 + 0.5, y as f64 + 0.5), f64::from(depth));
        self.positions.push(position.to_array());
        self.views.push(view as u32);
        self.pixels.push(pixel as u32);
        self.depths.push(depth);
    }
}

/// `n` anchors of `views` views, in any order of views.
pub(crate) fn set(shape: &str, n: usize, views: usize, seed: u64) -> Set {
    let mut draw = Draw(seed);
    let offset = if shape == "far" { DVec3::new(1e4, -1e4, 1e4) } else { DVec3::ZERO };
    let cameras = (0..views).map(|view| camera(shape, view, offset, &mut draw)).collect();
    let mut set = Set { cameras, ..Set::default() };
    let few = draw.below(3) == 0;
    for _ in 0..n {
        let view = draw.below(views);
        let size = set.cameras[view].width() * set.cameras[view].height();
        let pixel = match shape {
            "one pixel" => size / 2,
            // Many anchors of the same pixel.
            _ if few => draw.below(size.min(9)),
            _ => draw.below(size),
        };
        let depth = match shape {
            "lattice" => [1.0, 2.0, 4.0][draw.below(3)],
            _ => draw.within(0.5, 6.0) as f32,
        };
        set.lift(view, pixel, depth);
        if shape == "contradictory" {
            // Depth, position and pixel have nothing to do with each other.
            let last = set.depths.len() - 1;
            set.positions[last] = draw.point(3.0).to_array();
            set.depths[last] = [0.0, -1.0, 1e-40, f32::MAX, f32::MIN, 2.0, 3.0][draw.below(7)];
        }
    }
    set
}

fn camera(shape: &str, view: usize, offset: DVec3, draw: &mut Draw) -> Camera {
    let (width, height) = [(64, 48), (33, 20), (5, 70), (200, 1), (1, 1), (17, 17)][draw.below(6)];
    let focal = draw.within(0.3, 2.0) * width as f64;
    let lens = Intrinsics {
        fx: focal,
        fy: focal * 1.1,
        cx: width as f64 / 2.0,
        cy: height as f64 / 2.0,
        width,
        height,
    };
    let place = match shape {
        // Shifts by whole pixels at depths that are powers of two: many equal distances.
        "lattice" => {
            let lens = Intrinsics { fx: 16.0, fy: 16.0, cx: 16.0, cy: 8.0, width: 32, height: 16 };
            let shift = DVec3::new(draw.below(5) as f64 / 4.0, draw.below(3) as f64 / 4.0, 0.0);
            return Camera::new(lens, DMat3::IDENTITY, shift).unwrap();
        }
        "inside" | "contradictory" => {
            let angles = draw.point(3.0);
            let rotation = DMat3::from_euler(EulerRot::XYZ, angles.x, angles.y, angles.z);
            return Camera::new(lens, rotation, draw.point(2.0)).unwrap();
        }
        "opposite" => {
            DVec3::new(0.3 * draw.within(-1.0, 1.0), 0.0, if view.is_multiple_of(2) { -3.0 } else { 3.0 })
        }
        _ => DVec3::new(view as f64 * 0.4 - 1.0, draw.within(-0.3, 0.3), -3.0),
    };
    Camera::looking_at(lens, offset + place, offset, DVec3::Y).unwrap()
}
