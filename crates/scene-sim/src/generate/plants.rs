//! Trees, bushes, hedges and flowers.

use crate::Pattern;
use crate::generate::form::Form;
use crate::generate::palette::EARTH;
use crate::generate::set::{Frame, Set};
use crate::stage::{noise, v};
use glam::{DVec2, DVec3};

/// Lengths of the leaves of a tree, metres.
pub(crate) const LEAVES: [f64; 2] = [0.09, 0.14];

impl Set {
    /// A tree on the origin, `tall` metres, with leaves of a length between the two, metres.
    pub(crate) fn tree(&mut self, frame: &Frame, name: &str, tall: f64, leaf: [f64; 2]) {
        let bark = self.random.pick(&[[0.36, 0.28, 0.21], [0.45, 0.41, 0.36], [0.30, 0.22, 0.17]]);
        let bark = noise(bark.map(|c| 0.55 * c), bark, 0.08, 4);
        let slim = tall * self.random.within(0.018, 0.028);
        let fork = tall * self.random.within(0.3, 0.42);
        let top =
            v(self.random.within(-0.03, 0.03) * tall, self.random.within(-0.03, 0.03) * tall, 0.72 * tall);
        let trunk = Form::lathe(&[(1.5 * slim, -0.05), (1.05 * slim, 0.1 * fork), (0.85 * slim, fork)], 14);
        self.mesh(frame, &format!("{name} trunk"), trunk, DVec3::ZERO, DVec3::ZERO, bark);
        let stem = [v(0.0, 0.0, 0.97 * fork), top];
        self.rod(frame, &format!("{name} branch"), 0.6 * slim, stem, bark);
        let (branch, crown) = (format!("{name} branch"), format!("{name} crown"));
        let leaves = {
            let leaf = self.random.within(leaf[0], leaf[1]);
            self.random.leaves(leaf, 0.5)
        };
        let sheet = (0.13 * tall).min(0.6);
        let limbs = self.random.count(4, 6);
        for k in 0..limbs {
            let turn =
                std::f64::consts::TAU * (f64::from(k) + self.random.within(-0.2, 0.2)) / f64::from(limbs);
            let out = DVec2::from_angle(turn) * (tall * self.random.within(0.15, 0.24));
            let tip = out.extend(tall * self.random.within(0.55, 0.75));
            let from = v(0.0, 0.0, fork).lerp(top, self.random.within(0.0, 0.4));
            self.rod(frame, &branch, 0.35 * slim, [from, tip], bark);
            let half = v(0.17, 0.17, 0.13) * (tall * self.random.within(0.8, 1.2));
            let form = Form::crown(&mut self.random, half, 90, sheet);
            self.mesh(frame, &crown, form, tip, DVec3::ZERO, leaves);
        }
        let form = Form::crown(&mut self.random, v(0.2, 0.2, 0.2) * tall, 130, sheet);
        self.mesh(frame, &crown, form, v(top.x, top.y, 0.78 * tall), DVec3::ZERO, leaves);
    }

    /// A bush on the origin.
    pub(crate) fn bush(&mut self, frame: &Frame, size: DVec3) {
        let (leaf, half) = (self.random.within(0.035, 0.07), 0.5 * size);
        let leaves = self.random.leaves(leaf, 0.62);
        let sheets = (60.0 * (size.x * size.y * size.z).cbrt().max(0.5)) as u32 + 50;
        let form = Form::crown(&mut self.random, half * v(0.95, 0.95, 0.9), sheets, 0.4 * size.z.min(0.9));
        self.mesh(frame, "bush", form, v(0.0, 0.0, 0.92 * half.z), DVec3::ZERO, leaves);
        let Pattern::Foliage { dark, .. } = leaves else { return };
        let shade = noise(dark.map(|c| 0.6 * c), dark, 0.06, 4);
        let form = Form::cushion(size * v(0.72, 0.72, 0.8), 0.8);
        self.mesh(frame, "shade in the bush", form, DVec3::ZERO, DVec3::ZERO, shade);
    }

    /// A clipped hedge that stands on the origin: a dark body with leaves around it.
    pub(crate) fn hedge(&mut self, frame: &Frame, size: DVec3) {
        let leaf = self.random.within(0.035, 0.06);
        let leaves = self.random.leaves(leaf, 0.75);
        let Pattern::Foliage { dark, light, .. } = leaves else { return };
        let body = noise(dark.map(|c| 0.5 * c), dark, 0.07, 4);
        self.block(frame, "hedge", size - v(0.08, 0.08, 0.04), DVec3::ZERO, body);
        self.block(frame, "leaves of the hedge", size, DVec3::ZERO, leaves);
        let thin = Pattern::Foliage { dark, light, leaf, cover: 0.4 };
        self.block(frame, "twigs of the hedge", size + v(0.07, 0.07, 0.05), DVec3::ZERO, thin);
    }

    /// A bed of earth with flowers and leaves, its middle at the origin.
    pub(crate) fn flower_bed(&mut self, frame: &Frame, size: DVec2) {
        let earth = noise(EARTH.map(|c| 0.6 * c), EARTH.map(|c| 1.5 * c), 0.12, 5);
        self.block(frame, "flower bed", size.extend(0.04), DVec3::ZERO, earth);
        let blooms = [
            [0.86, 0.24, 0.26],
            [0.95, 0.78, 0.22],
            [0.90, 0.88, 0.86],
            [0.58, 0.34, 0.66],
            [0.92, 0.52, 0.62],
            [0.34, 0.40, 0.72],
        ];
        let green = self.random.green();
        let area = size.x * size.y;
        let inner = size - DVec2::splat(0.12);
        let count = (area * 60.0).min(260.0) as u32;
        let grass = Form::tufts(&mut self.random, inner, count, 0.2, &[green]);
        self.mesh(
            frame,
            "leaves of the flowers",
            grass,
            v(0.0, 0.0, 0.04),
            DVec3::ZERO,
            Pattern::VertexColours,
        );
        let kinds = [self.random.pick(&blooms), self.random.pick(&blooms)];
        let heads = (area * 26.0).min(120.0) as u32;
        for _ in 0..heads {
            let place =
                v(self.random.within(-0.5, 0.5) * inner.x, self.random.within(-0.5, 0.5) * inner.y, 0.04);
            let (tall, petal) = (self.random.within(0.14, 0.34), self.random.pick(&kinds));
            let stem = crate::stage::plain(green.map(|c| 0.8 * c));
            self.rod(frame, "stem of a flower", 0.004, [place, place + v(0.0, 0.0, tall)], stem);
            let bloom = crate::stage::plain(self.random.near(petal, 0.06));
            let radius = self.random.within(0.016, 0.034);
            self.ball(frame, "flower", radius, place + v(0.0, 0.0, tall), bloom);
        }
    }
}
