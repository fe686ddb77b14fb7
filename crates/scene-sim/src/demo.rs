//! The scene of the demonstration: the corner of a courtyard in the afternoon sun.

use crate::stage::{DARK_WOOD, Stage, noise, plain, print, v, wood};
use crate::trajectory::{Trajectory, lens};
use crate::{Pattern, Result, Rgb, Scene, Shape, Sky, Sun};
use gs_scene::Camera;

const WHITE: Rgb = [0.96, 0.955, 0.93];

impl Stage {
    fn surroundings(&mut self) {
        let brick = Pattern::Brick {
            brick: [0.66, 0.36, 0.27],
            mortar: [0.76, 0.72, 0.66],
            length: 0.25,
            height: 0.085,
            joint: 0.012,
        };
        let tiles = Pattern::Checker { colours: [[0.86, 0.82, 0.74], [0.56, 0.47, 0.42]], cell: 0.4 };
        let grass = noise([0.20, 0.30, 0.10], [0.52, 0.62, 0.26], 0.8, 6);
        let leaves = noise([0.10, 0.20, 0.07], [0.46, 0.64, 0.25], 0.3, 6);
        self.put("lawn", Shape::Rectangle { width: 40.0, height: 40.0 }, v(0.0, 0.0, -0.02), grass);
        let paving = Shape::Rectangle { width: 7.2, height: 7.2 };
        self.put("paving", paving, v(-0.4, 0.0, 0.0), tiles).material.mottle = 0.35;
        self.stand("brick wall", v(5.0, 0.3, 1.9), v(0.5, 3.15, 0.0), 0.0, brick);
        self.stand("coping", v(5.06, 0.38, 0.07), v(0.5, 3.15, 1.9), 0.0, plain([0.72, 0.69, 0.64]));
        self.stand("plaster wall", v(0.3, 6.0, 2.8), v(3.15, 0.3, 0.0), 0.0, plain(WHITE));
        self.stand("skirting", v(0.02, 5.4, 0.25), v(2.99, 0.3, 0.0), 0.0, plain([0.55, 0.56, 0.58]));
        self.stand("hedge", v(6.0, 0.8, 1.8), v(-5.1, 3.5, 0.0), 0.0, leaves);
        self.put("tree crown", Shape::Sphere { radius: 1.5 }, v(-0.6, 7.5, 2.9), leaves);
        self.put(
            "tree trunk",
            Shape::Cylinder { radius: 0.18, height: 2.2 },
            v(-0.6, 7.5, 1.1),
            plain(DARK_WOOD),
        );
    }

    fn furniture(&mut self) {
        self.table("table", v(0.4, 0.5, 0.0), v(1.7, 0.95, 0.74), 0.075, 8.0, 0.158);
        self.table("bench", v(-0.4, 2.55, 0.0), v(1.5, 0.4, 0.46), 0.07, 0.0, 0.13);
        let poster = Shape::Rectangle { width: 0.95, height: 1.3 };
        let poster = self.put(
            "poster",
            poster,
            v(2.985, 1.75, 1.6),
            print([0.95, 0.93, 0.86], [0.16, 0.42, 0.55], 0.06),
        );
        // Upright, its front towards -x.
        poster.rotation = v(90.0, 0.0, -90.0);
        let crate_wood = wood(0.14);
        self.stand("crate", v(0.6, 0.5, 0.42), v(2.3, 2.3, 0.0), 12.0, crate_wood);
        self.stand(
            "parcel",
            v(0.42, 0.34, 0.30),
            v(2.3, 2.3, 0.42),
            -14.0,
            print([0.74, 0.58, 0.40], [0.45, 0.22, 0.12], 0.035),
        );
        let concrete = noise([0.48, 0.48, 0.47], [0.72, 0.71, 0.69], 0.3, 6);
        self.stand("planter", v(0.55, 0.55, 0.5), v(-1.75, 2.6, 0.0), 0.0, concrete);
        let leaves = noise([0.08, 0.20, 0.06], [0.45, 0.68, 0.24], 0.12, 5);
        self.put("bush", Shape::Sphere { radius: 0.42 }, v(-1.75, 2.6, 0.85), leaves);
        let stripes = Pattern::Checker { colours: [[0.92, 0.90, 0.84], [0.78, 0.24, 0.18]], cell: 0.1472 };
        self.put("ball", Shape::Sphere { radius: 0.2812 }, v(-0.75, 0.55, 0.2812), stripes).rotation =
            v(25.0, 20.0, 40.0);
        self.put(
            "pot",
            Shape::Cylinder { radius: 0.17, height: 0.32 },
            v(2.4, 0.0, 0.16),
            plain([0.72, 0.38, 0.24]),
        );
        self.put("pot plant", Shape::Sphere { radius: 0.26 }, v(2.4, 0.0, 0.5), leaves);
    }

    fn things_on_the_table(&mut self) {
        const TOP: f64 = 0.74;
        let marble = noise([0.30, 0.42, 0.50], [0.85, 0.88, 0.88], 0.12, 5);
        self.put("marble sphere", Shape::Sphere { radius: 0.15 }, v(0.28, 0.55, TOP + 0.15), marble);
        self.stand(
            "cereal box",
            v(0.22, 0.08, 0.32),
            v(0.85, 0.72, TOP),
            -22.0,
            print([0.97, 0.84, 0.42], [0.75, 0.18, 0.14], 0.024),
        );
        self.stand(
            "tea box",
            v(0.16, 0.1, 0.14),
            v(0.62, 0.30, TOP),
            28.0,
            print([0.55, 0.72, 0.60], [0.14, 0.30, 0.22], 0.018),
        );
        self.stand(
            "big book",
            v(0.30, 0.22, 0.045),
            v(-0.12, 0.42, TOP),
            18.0,
            print([0.22, 0.32, 0.50], [0.92, 0.80, 0.45], 0.03),
        );
        self.stand(
            "small book",
            v(0.22, 0.16, 0.035),
            v(-0.11, 0.43, TOP + 0.045),
            -8.0,
            print([0.80, 0.76, 0.66], [0.60, 0.20, 0.18], 0.022),
        );
        self.put(
            "mug",
            Shape::Cylinder { radius: 0.042, height: 0.1 },
            v(0.38, 0.26, TOP + 0.05),
            plain([0.20, 0.45, 0.62]),
        );
        self.put(
            "orange",
            Shape::Sphere { radius: 0.042 },
            v(0.98, 0.38, TOP + 0.042),
            noise([0.85, 0.42, 0.08], [0.97, 0.60, 0.16], 0.03, 3),
        );
        self.put(
            "lime",
            Shape::Sphere { radius: 0.034 },
            v(1.07, 0.45, TOP + 0.034),
            plain([0.55, 0.68, 0.20]),
        );
    }
}

/// A courtyard corner in the sun, about 6 m across: brick wall, plain white wall, paving, lawn and hedge
/// under the sky; a wooden table with printed boxes, books, a mug, fruit and a sphere. Fine detail beside
/// large textureless parts, near things before far ones: what the paper's sampling is about.
#[must_use]
pub fn demo_scene() -> Scene {
    let mut stage = Stage::default();
    stage.surroundings();
    stage.furniture();
    stage.things_on_the_table();
    let sky = Sky {
        zenith: [0.36, 0.56, 0.86],
        horizon: [0.84, 0.90, 0.95],
        ground: [0.52, 0.54, 0.42],
        light: 0.62,
        occlusion: None,
    };
    let sun = Sun { towards: v(-0.74, -0.50, 0.80), colour: [1.0, 0.96, 0.88], strength: 0.9, diameter: 0.0 };
    Scene { primitives: stage.0, sun: Some(sun), ..Scene::under(sky) }
}

/// Cameras of the demonstration, along the arc of a person who walks around the table: six context views, and
/// the five held-out views half-way between them. Neighbouring context views are 8 degrees (0.6 m) apart.
///
/// # Errors
/// If the size is empty.
pub fn demo_cameras(width: usize, height: usize) -> Result<(Vec<Camera>, Vec<Camera>)> {
    let walk =
        Trajectory::Arc { target: v(0.4, 0.9, 0.95), radius: 4.3, height: 0.75, from: -132.0, to: -92.0 };
    let cameras = walk.cameras(lens(width, height, 62.0), 11)?;
    Ok((cameras.iter().copied().step_by(2).collect(), cameras.iter().copied().skip(1).step_by(2).collect()))
}
