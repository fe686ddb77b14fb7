//! A printed page.

use crate::noise::{cell, hash, unit, value};
use glam::{DVec2, DVec3};

pub(super) enum Stroke {
    Paper,
    Ink,
    /// How much of the accent colour covers the paper, 0..1.
    Accent(f64),
}

/// What is printed at a point of a page: a margin of one line, a heading three lines high with a bar below
/// it, text with paragraphs, and a picture in the lower right.
pub(super) fn print(uv: DVec2, extent: DVec2, line: f64, seed: u32) -> Stroke {
    // From here on in lines, from the top left corner of the text area.
    let size = extent / line - DVec2::splat(2.0);
    let p = DVec2::new(uv.x / line - 1.0, extent.y / line - uv.y / line - 1.0);
    if p.min_element() < 0.0 || p.x > size.x || p.y > size.y {
        return Stroke::Paper;
    }
    if p.y < 3.0 {
        return letter(p / 3.0, size.x / 3.0, 0, seed).map_or(Stroke::Paper, |()| Stroke::Accent(1.0));
    }
    if p.y < 4.0 {
        return if p.y < 3.3 { Stroke::Accent(1.0) } else { Stroke::Paper };
    }
    let picture = (p - size * DVec2::new(0.5, 0.55)) / (size * DVec2::new(0.5, 0.45));
    if picture.min_element() >= 0.0 {
        return image(picture, seed);
    }
    let row = p.y.floor() - 3.0;
    // Every sixth line is empty, the last one is whole, and no line but those beside the picture has the same
    // length.
    let beside = size.y * 0.55 - 1.0 < p.y;
    let room = if beside { size.x * 0.47 } else { size.x };
    let length = room * (0.75 + 0.25 * unit(hash(cell(row), 5, 3, seed)));
    if row % 6.0 == 5.0 || p.y.floor() + 1.0 > size.y {
        return Stroke::Paper;
    }
    letter(DVec2::new(p.x, p.y - p.y.floor() + row), length, 1, seed).map_or(Stroke::Paper, |()| Stroke::Ink)
}

/// A framed picture of soft hills under a disc, in 0..1 of its frame.
fn image(p: DVec2, seed: u32) -> Stroke {
    if p.min_element() < 0.04 || p.max_element() > 0.96 {
        return Stroke::Ink;
    }
    let place = |k| 0.25 + 0.5 * unit(hash(k, 6, 4, seed));
    if p.distance(DVec2::new(place(0), 0.6 * place(1))) < 0.14 {
        return Stroke::Accent(0.15);
    }
    let hills = (0..3).filter(|k| {
        let height = value(DVec3::new(p.x * 3.0, f64::from(*k) * 7.7, 0.5), seed);
        p.y > 0.25 + 0.22 * f64::from(*k) + 0.3 * height
    });
    Stroke::Accent(0.3 + 0.23 * hills.count() as f64)
}

/// Whether a point of a line of text, in line heights, lies on a letter. Words are of 1 to 8 letters.
fn letter(p: DVec2, length: f64, kind: u32, seed: u32) -> Option<()> {
    /// Width of a letter with its gap, as a share of the line height.
    const ADVANCE: f64 = 0.6;
    let column = (p.x / ADVANCE).floor();
    let row = p.y.floor();
    if (column + 1.0) * ADVANCE > length {
        return None;
    }
    let bits = hash(cell(column), cell(row), 8 + kind, seed);
    if bits.is_multiple_of(6) {
        return None;
    }
    // A glyph has 5 x 7 dots in a cell of 6 x 9.
    let dot = DVec2::new((p.x / ADVANCE - column) * 6.0, (p.y - row) * 9.0 - 1.0);
    if !(0.0..5.0).contains(&dot.x) || !(0.0..7.0).contains(&dot.y) {
        return None;
    }
    let glyph = GLYPHS[(bits >> 8) as usize % GLYPHS.len()];
    (glyph[dot.y as usize] >> (4 - dot.x as u32) & 1 == 1).then_some(())
}

/// The letters E T A O I N S H R D L U C M F P, seven rows of five dots each.
const GLYPHS: [[u8; 7]; 16] = [
    [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b11111],
    [0b11111, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100],
    [0b01110, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001],
    [0b01110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110],
    [0b01110, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110],
    [0b10001, 0b11001, 0b11001, 0b10101, 0b10011, 0b10011, 0b10001],
    [0b01111, 0b10000, 0b10000, 0b01110, 0b00001, 0b00001, 0b11110],
    [0b10001, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001],
    [0b11110, 0b10001, 0b10001, 0b11110, 0b10100, 0b10010, 0b10001],
    [0b11110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b11110],
    [0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b11111],
    [0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110],
    [0b01110, 0b10001, 0b10000, 0b10000, 0b10000, 0b10001, 0b01110],
    [0b10001, 0b11011, 0b10101, 0b10101, 0b10001, 0b10001, 0b10001],
    [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b10000],
    [0b11110, 0b10001, 0b10001, 0b11110, 0b10000, 0b10000, 0b10000],
];
