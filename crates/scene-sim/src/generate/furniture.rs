//! Furniture: its back at y = 0, its front towards -y, standing on z = 0, its middle at x = 0. A piece with a top says how
//! high that is.

use crate::Pattern;
use crate::generate::form::Form;
use crate::generate::palette::{BLACK, BRASS, STEEL, WHITE};
use crate::generate::set::{Frame, HAIR, Set};
use crate::stage::{plain, v};
use glam::{DVec2, DVec3};

const CORNERS: [(f64, f64); 4] = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)];

impl Set {
    /// A table with four legs, its middle at the origin.
    pub(crate) fn table(&mut self, frame: &Frame, name: &str, size: DVec3, wood: Pattern) {
        let (thick, leg) = (0.035 + 0.01 * size.x.min(1.5), 0.05);
        let top = format!("{name} top");
        self.block(frame, &top, v(size.x, size.y, thick), v(0.0, 0.0, size.z - thick), wood);
        let metal = self.random.chance(0.3);
        let legs = if metal { plain(self.random.pick(&[BLACK, STEEL, WHITE])) } else { wood };
        let (name, apron) = (format!("{name} leg"), format!("{name} apron"));
        for (sx, sy) in CORNERS {
            let foot = v(sx * (0.5 * size.x - 0.8 * leg), sy * (0.5 * size.y - 0.8 * leg), 0.0);
            self.post(frame, &name, v(leg, leg, size.z - thick), foot, legs);
        }
        let z = size.z - thick - 0.07;
        for side in [-1.0, 1.0] {
            let y = side * (0.5 * size.y - 0.8 * leg);
            self.block(frame, &apron, v(size.x - 2.6 * leg, 0.02, 0.07), v(0.0, y, z), legs);
        }
    }

    /// A chair; its middle at the origin.
    pub(crate) fn chair(&mut self, frame: &Frame, wood: Pattern, seat: Pattern) {
        let (width, deep, high, leg) = (0.42, 0.42, 0.45, 0.036);
        let (x, y) = (0.5 * (width - leg), 0.5 * (deep - leg));
        for (sx, sy) in CORNERS {
            let tall = if sy > 0.0 { 0.9 } else { high - 0.035 };
            self.post(frame, "chair leg", v(leg, leg, tall), v(sx * x, sy * y, 0.0), wood);
        }
        // Between the hind legs, over the front ones.
        let board = v(width, deep - leg - 0.002, 0.035);
        self.block(frame, "chair seat", board, v(0.0, -0.5 * leg - 0.001, high - 0.035), seat);
        let slat = self.random.count(2, 4);
        for k in 0..slat {
            let z = 0.56 + 0.28 * f64::from(k) / f64::from(slat - 1);
            self.block(frame, "chair slat", v(width - 2.0 * leg, 0.016, 0.05), v(0.0, y, z), wood);
        }
        for side in [-1.0, 1.0] {
            let z = 0.2 + 0.05 * side;
            self.block(
                frame,
                "chair stretcher",
                v(width - 2.0 * leg, 0.018, 0.025),
                v(0.0, side * y, z),
                wood,
            );
        }
    }

    /// A chair with castors, its middle at the origin.
    pub(crate) fn office_chair(&mut self, frame: &Frame) {
        let (frame_colour, cloth) = (plain(BLACK), self.random.fabric(0.03));
        for k in 0..5 {
            let out = DVec2::from_angle(f64::from(k) * 1.2566 + 0.3).extend(0.0);
            self.ball(frame, "castor", 0.028, out * 0.27 + v(0.0, 0.0, 0.028), frame_colour);
            let ends = [v(0.0, 0.0, 0.09), out * 0.27 + v(0.0, 0.0, 0.065)];
            self.rod(frame, "star foot", 0.018, ends, frame_colour);
        }
        self.column(frame, "gas spring", 0.025, 0.36, v(0.0, 0.0, 0.07), plain(STEEL));
        let seat = Form::cushion(v(0.48, 0.48, 0.09), 0.35);
        self.mesh(frame, "seat of the office chair", seat, v(0.0, 0.0, 0.425), DVec3::ZERO, cloth);
        let spine = [v(0.0, 0.17, 0.45), v(0.0, 0.26, 0.8)];
        self.rod(frame, "spine of the office chair", 0.02, spine, frame_colour);
        let back = Form::cushion(v(0.44, 0.08, 0.5), 0.4);
        self.mesh(frame, "back of the office chair", back, v(0.0, 0.22, 0.55), v(-8.0, 0.0, 0.0), cloth);
    }

    pub(crate) fn sofa(&mut self, frame: &Frame, width: f64) {
        let (deep, cloth) = (0.9, self.random.fabric(0.04));
        let (arm, high) = (self.random.within(0.14, 0.22), self.random.within(0.56, 0.66));
        for (sx, sy) in CORNERS {
            let foot = v(sx * (0.5 * width - 0.1), 0.5 * deep * (sy - 1.0) - 0.1 * sy, 0.0);
            self.column(frame, "foot of the sofa", 0.022, 0.1, foot, plain([0.25, 0.17, 0.11]));
        }
        self.block(
            frame,
            "body of the sofa",
            v(width - 0.01, deep - 0.01, 0.18),
            v(0.0, -0.5 * deep, 0.1),
            cloth,
        );
        for side in [-1.0, 1.0] {
            let form = Form::cushion(v(arm, deep, high - 0.1), 0.22);
            self.mesh(
                frame,
                "arm of the sofa",
                form,
                v(side * 0.5 * (width - arm), -0.5 * deep, 0.1),
                DVec3::ZERO,
                cloth,
            );
        }
        let inner = width - 2.0 * arm;
        let form = Form::cushion(v(inner + 0.03, 0.24, 0.72), 0.25);
        self.mesh(frame, "back of the sofa", form, v(0.0, -0.14, 0.12), DVec3::ZERO, cloth);
        let seats = if width > 1.7 { 3 } else { 2 };
        let each = inner / f64::from(seats);
        for k in 0..seats {
            let x = (f64::from(k) + 0.5) * each - 0.5 * inner;
            let form = Form::cushion(v(each - 0.006, deep - 0.24, 0.17), 0.25);
            self.mesh(frame, "seat of the sofa", form, v(x, -0.5 * deep - 0.1, 0.275), DVec3::ZERO, cloth);
            let form = Form::cushion(v(each - 0.01, 0.17, 0.42), 0.32);
            self.mesh(frame, "cushion of the sofa", form, v(x, -0.32, 0.43), v(-12.0, 0.0, 0.0), cloth);
            if self.random.chance(0.6) {
                let (edge, pillow) = (self.random.within(0.34, 0.42), self.random.fabric(0.05));
                let shift = self.random.within(-0.08, 0.08);
                let form = Form::cushion(v(edge, 0.14, edge), 0.5);
                let turn = v(-24.0, self.random.within(-9.0, 9.0), self.random.within(-15.0, 15.0));
                self.mesh(frame, "pillow", form, v(x + shift, -0.5, 0.44), turn, pillow);
            }
        }
    }

    pub(crate) fn bed(&mut self, frame: &Frame, width: f64) {
        let (long, wood) = (2.04, self.random.board(0.14));
        self.block(frame, "headboard", v(width + 0.06, 0.05, 1.0), v(0.0, -0.025, 0.0), wood);
        self.block(frame, "bed frame", v(width, long - 0.06, 0.2), v(0.0, -0.5 * long - 0.02, 0.1), wood);
        for (sx, sy) in CORNERS {
            let foot = v(sx * (0.5 * width - 0.08), -0.5 * long + sy * 0.85, 0.0);
            self.block(frame, "bed foot", v(0.06, 0.06, 0.1), foot, wood);
        }
        let sheet = plain(self.random.near([0.92, 0.91, 0.88], 0.04));
        let form = Form::cushion(v(width - 0.03, long - 0.1, 0.2), 0.15);
        self.mesh(frame, "mattress", form, v(0.0, -0.5 * long - 0.02, 0.3), DVec3::ZERO, sheet);
        let cover = self.random.fabric(0.09);
        let form = Form::cushion(v(width + 0.06, long - 0.6, 0.2), 0.2);
        self.mesh(frame, "blanket", form, v(0.0, -0.5 * long - 0.28, 0.36), DVec3::ZERO, cover);
        let pillows = if width > 1.2 { 2 } else { 1 };
        for k in 0..pillows {
            let x = if pillows == 1 { 0.0 } else { (f64::from(k) - 0.5) * 0.48 * width };
            let form = Form::cushion(v(0.62, 0.4, 0.15), 0.45);
            let turn = v(20.0, 0.0, self.random.within(-6.0, 6.0));
            self.mesh(frame, "pillow", form, v(x, -0.33, 0.49), turn, sheet);
        }
    }

    /// A case of shelves, filled; with a back, or open.
    pub(crate) fn bookcase(&mut self, frame: &Frame, size: DVec3) {
        let (wood, thick) = (self.random.board(0.18), 0.022);
        for side in [-1.0, 1.0] {
            let x = side * 0.5 * (size.x - thick);
            self.post(frame, "side of the shelf", v(thick, size.y, size.z), v(x, -0.5 * size.y, 0.0), wood);
        }
        let inner = size.x - 2.0 * thick;
        self.block(frame, "back of the shelf", v(inner, 0.006, size.z - 0.06), v(0.0, -0.003, 0.06), wood);
        let rows = ((size.z - 0.1) / self.random.within(0.29, 0.38)).floor().max(1.0) as u32;
        let pitch = (size.z - 0.06 - thick) / f64::from(rows);
        for row in 0..=rows {
            let z = 0.06 + pitch * f64::from(row);
            let board = v(inner, size.y - 0.012, thick);
            self.block(frame, "board of the shelf", board, v(0.0, -0.5 * size.y - 0.004, z), wood);
            if row < rows {
                let bay = frame.at(v(-0.5 * inner, -0.01, z + thick), 0.0);
                self.bay(&bay, inner, size.y - 0.03, pitch - thick);
            }
        }
        self.block(frame, "plinth of the shelf", v(inner, 0.016, 0.06), v(0.0, 0.03 - size.y, 0.0), wood);
    }

    /// What stands in one bay of a shelf, from x = 0 on.
    pub(crate) fn bay(&mut self, frame: &Frame, width: f64, deep: f64, clear: f64) {
        let mut x = 0.01;
        while width - x > 0.12 {
            let room = width - x - 0.01;
            let run = room.min(self.random.within(0.15, 0.55));
            let tallest = (clear - 0.02).min(0.31);
            let middle = frame.at(v(x + 0.5 * run, -0.5 * deep, 0.0), 0.0);
            match self.random.count(0, 14).saturating_sub(3) {
                0..=5 => self.books(&frame.at(v(x, 0.0, 0.0), 0.0), run, deep.min(0.24), tallest),
                6 => {
                    let (count, size) = (self.random.count(2, 5), (run / 1.18).min(deep).min(0.26));
                    if size > 0.13 {
                        self.pile_of_books(&middle, count, size);
                    }
                }
                7 => self.vase(&middle, (clear * 0.62).min(0.9 * run).min(0.28)),
                8 => {
                    let box_size = v(run - 0.02, deep * 0.8, (clear * 0.7).min(0.24));
                    let cover = if self.random.chance(0.4) {
                        self.random.printed(0.02)
                    } else {
                        self.random.fabric(0.05)
                    };
                    self.block(&middle, "storage box", box_size, DVec3::ZERO, cover);
                    let (lid, top) =
                        (v(box_size.x + 0.008, box_size.y + 0.008, 0.03), v(0.0, 0.0, box_size.z));
                    let colour = self.random.strong();
                    self.block(&middle, "lid of the box", lid, top, plain(colour));
                }
                9 if run > 0.2 && clear > 0.22 => {
                    self.potted(&middle, (clear * 0.75).min(1.4 * run).min(0.32));
                }
                10 if clear > 0.2 => {
                    let size = DVec2::new(0.8 * run.min(0.22), 0.7 * clear.min(0.3));
                    let stand = frame.at(v(x + 0.5 * run, -0.4 * deep, 0.5 * size.y), 0.0);
                    self.picture(&stand, size);
                }
                _ => {}
            }
            x += run + self.random.within(0.0, 0.05);
        }
    }

    /// A low cupboard with doors or drawers; its top is at `size.z`.
    pub(crate) fn sideboard(&mut self, frame: &Frame, size: DVec3) {
        let wood = self.random.board(0.2);
        let front = if self.random.chance(0.4) { plain(self.random.near(WHITE, 0.03)) } else { wood };
        let foot = 0.12;
        for (sx, sy) in CORNERS {
            let place = v(sx * (0.5 * size.x - 0.07), 0.5 * size.y * (sy - 1.0) - 0.06 * sy, 0.0);
            self.rod(frame, "foot of the sideboard", 0.016, [place, place + v(0.0, 0.0, foot)], plain(BLACK));
        }
        let body = v(size.x, size.y - 0.02, size.z - foot);
        self.block(frame, "sideboard", body, v(0.0, -0.5 * body.y, foot), wood);
        let columns = (size.x / 0.5).round().max(1.0) as u32;
        let each = (size.x - 0.03) / f64::from(columns);
        for column in 0..columns {
            let x = (f64::from(column) + 0.5) * each - 0.5 * (size.x - 0.03);
            let drawers = if self.random.chance(0.4) { 3 } else { 1 };
            let pitch = (body.z - 0.03) / f64::from(drawers);
            for drawer in 0..drawers {
                let z = foot + 0.015 + pitch * f64::from(drawer);
                let panel = v(each - 0.006, 0.018, pitch - 0.006);
                self.block(frame, "door of the sideboard", panel, v(x, -body.y - 0.009, z + 0.003), front);
                let knob = v(x, -body.y - 0.026, z + 0.5 * pitch);
                self.ball(frame, "knob", 0.012, knob, plain(BRASS));
            }
        }
    }

    /// A screen on a foot; its middle at the origin.
    pub(crate) fn monitor(&mut self, frame: &Frame, width: f64) {
        let (tall, casing) = (0.58 * width, plain(self.random.pick(&[BLACK, [0.2, 0.2, 0.21], STEEL])));
        self.block(frame, "foot of the monitor", v(0.24, 0.18, 0.012), v(0.0, 0.03, 0.0), casing);
        self.block(frame, "neck of the monitor", v(0.05, 0.02, 0.2), v(0.0, 0.06, 0.012), casing);
        self.block(frame, "monitor", v(width, 0.035, tall), v(0.0, 0.0325, 0.13), casing);
        let (edge, line) = (0.012, self.random.within(0.009, 0.016));
        let dark = self.random.chance(0.4);
        let accent = self.random.strong();
        let (paper, ink) = if dark {
            ([0.12, 0.14, 0.18], [0.80, 0.84, 0.82])
        } else {
            ([0.92, 0.93, 0.94], [0.16, 0.17, 0.20])
        };
        let page = Pattern::Print { paper, ink, accent, line };
        let screen = v(width - 2.0 * edge, 0.002, tall - 2.0 * edge);
        let lit = self.block(frame, "screen", screen, v(0.0, 0.014, 0.13 + edge), page);
        lit.material.finish = crate::Finish::Baked;
    }

    /// A keyboard and a mouse, the middle of the keyboard at the origin.
    pub(crate) fn keyboard(&mut self, frame: &Frame) {
        let dark = self.random.chance(0.6);
        let (body, keys) = if dark { (BLACK, [0.22, 0.22, 0.24]) } else { ([0.78, 0.78, 0.78], WHITE) };
        self.block(frame, "keyboard", v(0.44, 0.14, 0.012), DVec3::ZERO, plain(body));
        let accent = self.random.strong();
        for row in 0..5 {
            let mut x = -0.21;
            while x < 0.2 {
                let wide = if row == 0 && (-0.09..0.0).contains(&x) { 0.15 } else { 0.0265 };
                let wide = f64::min(wide, 0.213 - x);
                let y = -0.052 + 0.026 * f64::from(row);
                let odd = (row == 4 && x < -0.19) || (row == 2 && x > 0.18);
                let colour = plain(if odd { accent } else { keys });
                self.block(frame, "key", v(wide - 0.004, 0.021, 0.007), v(x + 0.5 * wide, y, 0.012), colour);
                x += wide + 0.0015;
            }
        }
        let form = Form::cushion(v(0.062, 0.11, 0.036), 0.6);
        let place = v(0.32, self.random.within(-0.02, 0.03), HAIR);
        let turn = self.random.within(-20.0, 20.0);
        self.mesh(frame, "mouse", form, place, v(0.0, 0.0, turn), plain(body));
    }

    /// A lamp with two arms; its foot at the origin.
    pub(crate) fn desk_lamp(&mut self, frame: &Frame, lit: bool) {
        let paint = if self.random.chance(0.6) {
            plain(self.random.pick(&[BLACK, WHITE, BRASS]))
        } else {
            plain(self.random.strong())
        };
        self.column(frame, "foot of the desk lamp", 0.085, 0.022, DVec3::ZERO, paint);
        let (elbow, head) = (v(-0.06, 0.03, 0.36), v(0.2, -0.06, 0.5));
        self.rod(frame, "arm of the desk lamp", 0.008, [v(0.0, 0.0, 0.02), elbow], paint);
        self.rod(frame, "arm of the desk lamp", 0.008, [elbow, head], paint);
        self.ball(frame, "joint of the desk lamp", 0.016, elbow, plain(STEEL));
        let shell = [(0.014, 0.1), (0.03, 0.1), (0.09, 0.0), (0.087, 0.0), (0.027, 0.095)];
        let place = head - v(0.0, 0.0, 0.09);
        self.mesh(frame, "head of the desk lamp", Form::lathe(&shell, 32), place, DVec3::ZERO, paint);
        if lit {
            let centre = place + v(0.0, 0.0, 0.012);
            self.light(frame, "bulb of the desk lamp", DVec2::splat(0.11), centre, [1.0, 0.90, 0.74], 0.22);
        }
    }

    /// A lamp that stands on the floor; its middle at the origin.
    pub(crate) fn floor_lamp(&mut self, frame: &Frame, lit: bool) {
        let metal = plain(self.random.pick(&[BLACK, BRASS, STEEL]));
        let tall = self.random.within(1.45, 1.7);
        self.column(frame, "foot of the floor lamp", 0.15, 0.025, DVec3::ZERO, metal);
        self.rod(
            frame,
            "pole of the floor lamp",
            0.011,
            [v(0.0, 0.0, 0.025), v(0.0, 0.0, tall - 0.1)],
            metal,
        );
        self.shade(frame, tall - 0.28, v(0.22, 0.15, 0.28), lit);
    }

    /// A carpet on the floor with a border; its middle at the origin.
    pub(crate) fn carpet(&mut self, frame: &Frame, size: DVec2) {
        let (border, inner) = (self.random.fabric(0.1), self.random.within(0.07, 0.16));
        let pattern = match self.random.count(0, 3) {
            0 => self.random.fabric(0.3),
            1 => {
                let colours = [self.random.strong(), self.random.strong()];
                Pattern::Checker { colours, cell: self.random.within(0.06, 0.25) }
            }
            _ => {
                let (dark, light) = (self.random.strong(), self.random.paint());
                crate::stage::noise(dark, light, self.random.within(0.1, 0.35), 5)
            }
        };
        self.block(frame, "border of the carpet", size.extend(0.008), DVec3::ZERO, border);
        self.block(frame, "carpet", (size - 2.0 * inner).extend(0.002), v(0.0, 0.0, 0.008), pattern);
    }
}
