//! Matches between two pictures, found without their poses.

use super::features::{Descriptor, Feature, Features, LENGTH};
use super::fundamental::fundamental_inliers;
use super::grey::Grey;
use super::linear::{add_square, solve};
use glam::{DMat2, DVec2};

/// A point that two pictures show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Match {
    /// Pixels of the first picture.
    pub(crate) first: DVec2,
    /// Pixels of the second one.
    pub(crate) second: DVec2,
}

/// The matches of two pictures that agree with one epipolar geometry, whichever that is: mutually nearest
/// descriptors, clearly nearer than the second nearest, aligned to a fraction of a pixel, and then filtered
/// by a fundamental matrix. Empty where the pictures do not match. `straighten` takes a position in the first
/// (0) or second (1) picture to where a pinhole would have it; matches are returned in such positions.
pub(crate) fn match_pictures(
    first: &Features,
    second: &Features,
    seed: u64,
    straighten: impl Fn(usize, DVec2) -> Option<DVec2>,
) -> Vec<Match> {
    let straight = |found: Match| {
        Some(Match { first: straighten(0, found.first)?, second: straighten(1, found.second)? })
    };
    let candidates = mutual(&first.found, &second.found);
    // Aligning costs most, so that it is left to what is roughly right.
    let rough: Vec<(usize, usize, Match)> = candidates
        .into_iter()
        .filter_map(|(i, j)| {
            let found = Match { first: first.found[i].position, second: second.found[j].position };
            Some((i, j, straight(found)?))
        })
        .collect();
    let positions: Vec<Match> = rough.iter().map(|(_, _, found)| *found).collect();
    let Some(kept) = fundamental_inliers(&positions, ROUGH, seed) else { return Vec::new() };
    let aligned: Vec<Match> = kept
        .into_iter()
        .filter_map(|k| {
            let (i, j, _) = rough[k];
            straight(align(first, &first.found[i], second, &second.found[j])?)
        })
        .collect();
    let Some(kept) = fundamental_inliers(&aligned, FINE, seed ^ 1) else { return Vec::new() };
    kept.into_iter().map(|k| aligned[k]).collect()
}

/// Bounds on the symmetric epipolar distance to the pair's own fundamental matrix before and after alignment,
/// pixels.
const ROUGH: f64 = 3.0;
const FINE: f64 = 1.0;

/// Nearest must be so much nearer than the second nearest, as a ratio of distances (Lowe's test).
const RATIO: f64 = 0.8;
/// Neighbours of the nearest feature, pixels, are the same corner on another level and do not count as second
/// nearest.
const SAME_CORNER: f64 = 8.0;

/// Pairs of features that are each other's nearest and pass the ratio test.
fn mutual(first: &[Feature], second: &[Feature]) -> Vec<(usize, usize)> {
    if first.is_empty() || second.is_empty() {
        return Vec::new();
    }
    let mut best_of_second = vec![(i32::MIN, 0); second.len()];
    let mut row = vec![0; second.len()];
    let mut nearest = Vec::with_capacity(first.len());
    for (i, feature) in first.iter().enumerate() {
        for ((value, other), best) in row.iter_mut().zip(second).zip(&mut best_of_second) {
            *value = dot(&feature.descriptor, &other.descriptor);
            if *value > best.0 {
                *best = (*value, i);
            }
        }
        let (mut best, mut partner) = (i32::MIN, 0);
        for (j, &value) in row.iter().enumerate() {
            if value > best {
                (best, partner) = (value, j);
            }
        }
        let apart = |j: usize| second[j].position.distance(second[partner].position) > SAME_CORNER;
        let others = row.iter().enumerate().filter(|&(j, &value)| value > best / 2 && apart(j));
        let runner_up = others.map(|(_, &value)| value).max().unwrap_or(best / 2);
        nearest.push((partner, passes_ratio(best, runner_up)));
    }
    let is_mutual = |&(i, &(j, passes)): &(usize, &(usize, bool))| passes && best_of_second[j].1 == i;
    nearest.iter().enumerate().filter(is_mutual).map(|(i, &(j, _))| (i, j)).collect()
}

/// Whether the squared distances 2 L² - 2 dot keep [`RATIO`].
fn passes_ratio(best: i32, runner_up: i32) -> bool {
    let squared = |dot: i32| (2.0 * f64::from(LENGTH).powi(2) - 2.0 * f64::from(dot)).max(0.0);
    squared(best) < RATIO * RATIO * squared(runner_up)
}

fn dot(a: &Descriptor, b: &Descriptor) -> i32 {
    a.iter().zip(b).map(|(a, b)| i32::from(*a) * i32::from(*b)).sum()
}

/// Half side of the patch that is aligned, pixels.
const RADIUS: isize = 7;
const SAMPLES: usize = ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as usize;
const MAX_STEPS: usize = 15;
/// Pixels of the level. A match that moves farther was not this corner.
const MAX_SHIFT: f64 = 4.0;
/// Normalised correlation of two aligned patches, at least.
const MIN_CORRELATION: f32 = 0.8;
/// Pixels of the level; at this step the position has settled.
const SETTLED: f64 = 0.01;

/// The match with its second position aligned: the affine warp of the first patch that lies best on the
/// second picture, up to gain and offset of the brightness (Lucas and Kanade's method, inverse
/// compositional). `None` if it runs away, leaves the picture, or the patches do not look alike.
fn align(first: &Features, a: &Feature, second: &Features, b: &Feature) -> Option<Match> {
    let patch = Patch::new(&first.levels[a.level], a.pixel)?;
    let level = &second.levels[b.level];
    let start = DVec2::new(b.pixel.0 as f64 + 0.5, b.pixel.1 as f64 + 0.5);
    let (mut linear, mut centre) = (DMat2::IDENTITY, start);
    let mut correlation = 0.0;
    for _ in 0..MAX_STEPS {
        let (values, found) = patch.compare(level, linear, centre)?;
        correlation = found;
        let step = solve(&patch.normal, patch.against(&values))?;
        let [tx, ty, xx, xy, yx, yy] = step;
        // The patch's own warp that explains the difference, undone.
        let update = DMat2::from_cols(DVec2::new(1.0 + xx, yx), DVec2::new(xy, 1.0 + yy));
        if update.determinant() < 0.1 {
            return None;
        }
        let inverse = update.inverse();
        linear *= inverse;
        let moved = linear * DVec2::new(tx, ty);
        centre -= moved;
        let squeezed = !(0.25..=4.0).contains(&linear.determinant());
        let near = centre.distance(start) <= MAX_SHIFT;
        if squeezed || !near {
            return None;
        }
        if moved.length() < SETTLED {
            break;
        }
    }
    (correlation >= MIN_CORRELATION)
        .then(|| Match { first: a.position, second: centre * second.scale(b.level) })
}

/// A patch of a picture, of zero mean and unit length, ready to be aligned.
struct Patch {
    values: [f32; SAMPLES],
    /// Derivatives of the values by the six parameters of an affine warp, in the order tx, ty, xx, xy, yx,
    /// yy.
    slopes: Vec<[f32; 6]>,
    /// Sum of their products.
    normal: [[f64; 6]; 6],
}

impl Patch {
    fn new(level: &Grey, (x, y): (usize, usize)) -> Option<Self> {
        let reach = RADIUS as usize + 1;
        let inside = x >= reach && y >= reach && x + reach < level.width && y + reach < level.height;
        if !inside {
            return None;
        }
        let sample = |column: isize, row: isize| {
            let (column, row) = (x.strict_add_signed(column), y.strict_add_signed(row));
            f32::from(level.data[row * level.width + column])
        };
        let mut values = [0.0; SAMPLES];
        let mut slopes = Vec::with_capacity(SAMPLES);
        for (value, (column, row)) in values.iter_mut().zip(offsets()) {
            *value = sample(column, row);
            let dx = 0.5 * (sample(column + 1, row) - sample(column - 1, row));
            let dy = 0.5 * (sample(column, row + 1) - sample(column, row - 1));
            let (column, row) = (column as f32, row as f32);
            slopes.push([dx, dy, dx * column, dx * row, dy * column, dy * row]);
        }
        let length = normalise(&mut values)?;
        slopes.iter_mut().flatten().for_each(|slope| *slope /= length);
        let mut normal = [[0.0; 6]; 6];
        for slope in &slopes {
            add_square(&mut normal, &slope.map(f64::from));
        }
        Some(Self { values, slopes, normal })
    }

    /// The normalised values of a picture under the patch warped there, less the patch's own; and their
    /// correlation.
    fn compare(&self, level: &Grey, linear: DMat2, centre: DVec2) -> Option<([f32; SAMPLES], f32)> {
        let mut values = [0.0; SAMPLES];
        for (value, (column, row)) in values.iter_mut().zip(offsets()) {
            *value = level.sample(centre + linear * DVec2::new(column as f64, row as f64))?;
        }
        normalise(&mut values)?;
        let mut correlation = 0.0;
        for (value, reference) in values.iter_mut().zip(&self.values) {
            correlation += *value * reference;
            *value -= reference;
        }
        Some((values, correlation))
    }

    fn against(&self, differences: &[f32; SAMPLES]) -> [f64; 6] {
        let mut sum = [0.0; 6];
        for (slope, difference) in self.slopes.iter().zip(differences) {
            for (sum, slope) in sum.iter_mut().zip(slope) {
                *sum += f64::from(slope * difference);
            }
        }
        sum
    }
}

fn offsets() -> impl Iterator<Item = (isize, isize)> {
    (-RADIUS..=RADIUS).flat_map(|row| (-RADIUS..=RADIUS).map(move |column| (column, row)))
}

/// Zero mean, unit length; the length it had, `None` for a flat patch.
fn normalise(values: &mut [f32; SAMPLES]) -> Option<f32> {
    let mean = values.iter().sum::<f32>() / SAMPLES as f32;
    values.iter_mut().for_each(|value| *value -= mean);
    let length = values.iter().map(|value| value * value).sum::<f32>().sqrt();
    // One grey level per pixel is noise.
    (length > (SAMPLES as f32).sqrt()).then(|| {
        values.iter_mut().for_each(|value| *value /= length);
        length
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    /// Smooth noise with detail at several scales, as a function of the position.
    fn pattern(p: DVec2) -> f64 {
        let hash = |x: i64, y: i64| {
            let mut v = (x as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15)
                ^ (y as u64).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
            v = (v ^ (v >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            ((v ^ (v >> 32)) & 0xffff) as f64 / 65535.0
        };
        let octave = |p: DVec2| {
            let cell = p.floor();
            let f = p - cell;
            let (x, y) = (cell.x as i64, cell.y as i64);
            let s = f * f * (DVec2::splat(3.0) - 2.0 * f);
            let top = hash(x, y) * (1.0 - s.x) + hash(x + 1, y) * s.x;
            let bottom = hash(x, y + 1) * (1.0 - s.x) + hash(x + 1, y + 1) * s.x;
            top * (1.0 - s.y) + bottom * s.y
        };
        40.0 + 100.0 * octave(p / 23.0)
            + 60.0 * octave(p / 9.0 + DVec2::splat(100.0))
            + 30.0 * octave(p / 4.0 - DVec2::splat(57.0))
    }

    /// The pattern seen through a homography from the picture to the pattern.
    fn picture(to_pattern: DMat3, gain: f64) -> Grey {
        let (width, height) = (320, 240);
        let value = |i: usize| {
            let p = to_pattern * DVec2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5).extend(1.0);
            (gain * pattern(p.truncate() / p.z)).clamp(0.0, 255.0).round() as u8
        };
        Grey { width, height, data: (0..width * height).map(value).collect() }
    }

    #[test]
    fn warped_pictures_match_to_a_fraction_of_a_pixel() {
        let warp = DMat3::from_cols_array(&[0.93, 0.05, 1e-4, -0.08, 0.97, -6e-5, 11.3, 4.6, 1.0]);
        let (a, b) = (picture(DMat3::IDENTITY, 1.0), picture(warp, 0.8));
        let (a, b) = (Features::new(a, 600), Features::new(b, 600));
        let found = match_pictures(&a, &b, 3, |_, p| Some(p));
        assert!(found.len() > 80, "{}", found.len());
        let mut errors: Vec<f64> = found
            .iter()
            .map(|m| {
                let p = warp * m.second.extend(1.0);
                m.first.distance(p.truncate() / p.z)
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        let (median, worst) = (errors[errors.len() / 2], errors[errors.len() * 9 / 10]);
        assert!(median < 0.12 && worst < 0.5, "{median} {worst}");
        assert_eq!(found, match_pictures(&a, &b, 3, |_, p| Some(p)), "the same bits twice");
    }

    #[test]
    fn pictures_of_other_things_and_flat_ones_do_not_match() {
        let a = Features::new(picture(DMat3::IDENTITY, 1.0), 600);
        let elsewhere = DMat3::from_translation(DVec2::new(5000.0, -3000.0));
        let b = Features::new(picture(elsewhere, 1.0), 600);
        assert_eq!(match_pictures(&a, &b, 3, |_, p| Some(p)), []);
        let black = Features::new(Grey { width: 320, height: 240, data: vec![0; 320 * 240] }, 600);
        assert_eq!(match_pictures(&a, &black, 3, |_, p| Some(p)), []);
        assert_eq!(match_pictures(&black, &black, 3, |_, p| Some(p)), []);
        assert_eq!(match_pictures(&a, &a, 3, |_, _| None), []);
    }
}
