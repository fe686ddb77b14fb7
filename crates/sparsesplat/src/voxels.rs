//! Anchors by voxels: the voxel-aligned baseline.
//!
//! It represents AnySplat and VolSplat, which average the content of each voxel of a uniform grid to one Gaussian. They set the size of a voxel, and
//! the count follows. Here the count is given and the size is solved for it; a remainder of at most one in [`SLACK`] comes from halving the fullest voxels.
//!
//! The view with most pixels in a voxel is the home of the voxel. Of the voxel's pixels, those within the picture of the home are averaged by
//! confidence: position, normal, colour, features. Their spread in that picture is the cell. After that voxels are ordinary anchors, with neighbours, a
//! head and a decoder. AnySplat weights by a softmax of learned confidence, and VolSplat refines voxels by a network in space; this baseline has neither.

use crate::cells::{Cell, PIXEL_VARIANCE};
use backproject::Anchors;
use depth_backbone::ViewGeometry;
use glam::{DVec2, DVec3};
use gs_scene::View;
use rayon::prelude::*;
use std::ops::Range;

/// The grid is fine enough if at most one in so many voxels is missing.
const SLACK: usize = 64;
/// Sizes that are tried at most; five or six are usual.
const TRIALS: usize = 48;
/// Bits of a voxel's place along an axis.
const BITS: u32 = 21;

/// Voxels as anchors.
pub(crate) struct Voxels {
    /// By home view, then by the pixel nearest to the middle, which is the anchor's.
    pub(crate) anchors: Anchors,
    /// Which of them each view is home to.
    pub(crate) ranges: Vec<Range<usize>>,
    /// What they stand for in their home's picture; the centre is where the anchor is seen.
    pub(crate) cells: Vec<Cell>,
}

/// One voxel: its anchor's place in the set of all pixels, and the averages.
struct Voxel {
    pixel: usize,
    position: DVec3,
    normal: DVec3,
    depth: f64,
    cell: Cell,
    features: Vec<f32>,
}

/// `count` voxels (at least 1), or one per pixel if those are fewer, of all usable pixels of `views`.
pub(crate) fn voxels(pixels: &Anchors, views: &[View], geometry: &[ViewGeometry], count: usize) -> Voxels {
    let groups = groups(&pixels.positions, &pixels.footprints, count);
    let mut voxels: Vec<Voxel> =
        groups.into_par_iter().map(|members| average(pixels, &members, views, geometry)).collect();
    voxels.par_sort_unstable_by_key(|voxel| voxel.pixel);

    let mut anchors = Anchors { channels: pixels.channels, ..Anchors::default() };
    let mut first = 0;
    let ranges = (0..views.len())
        .map(|view| {
            let end = voxels.partition_point(|voxel| pixels.views[voxel.pixel] as usize <= view);
            std::mem::replace(&mut first, end)..end
        })
        .collect();
    for voxel in &voxels {
        let view = pixels.views[voxel.pixel];
        let camera = views[view as usize].camera();
        let lens = camera.intrinsics();
        anchors.positions.push(voxel.position.to_array());
        anchors.normals.push(voxel.normal.as_vec3().to_array());
        anchors.rays.push((voxel.position - camera.position()).normalize_or_zero().as_vec3().to_array());
        anchors.depths.push(voxel.depth as f32);
        anchors.footprints.push((voxel.depth / (lens.fx * lens.fy).sqrt()) as f32);
        anchors.features.extend_from_slice(&voxel.features);
        anchors.pixels.push(pixels.pixels[voxel.pixel]);
        anchors.views.push(view);
    }
    Voxels { anchors, ranges, cells: voxels.iter().map(|voxel| voxel.cell).collect() }
}

/// What the pixels `members` (ascending) come to.
fn average(pixels: &Anchors, members: &[u32], views: &[View], geometry: &[ViewGeometry]) -> Voxel {
    let view_of = |i: u32| pixels.views[i as usize] as usize;
    let pixel_of = |i: u32| pixels.pixels[i as usize] as usize;
    let confidence = |i: u32| f64::from(geometry[view_of(i)].confidence[pixel_of(i)]);
    // Members ascend by view; of equals the first is home.
    let mut home = (0, f64::NEG_INFINITY);
    for of_view in members.chunk_by(|&i, &j| view_of(i) == view_of(j)) {
        let weight = of_view.iter().map(|&i| confidence(i)).sum();
        if weight > home.1 {
            home = (view_of(of_view[0]), weight);
        }
    }
    let home = home.0;
    let camera = views[home].camera();
    let seen_from_home = |&i: &u32| {
        if view_of(i) == home {
            let (pixel, width) = (pixel_of(i), camera.width());
            return Some((i, DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5)));
        }
        let place = camera.project(DVec3::from(pixels.positions[i as usize]));
        place.filter(|&place| camera.contains(place)).map(|place| (i, place))
    };
    let seen: Vec<(u32, DVec2)> = members.iter().filter_map(seen_from_home).collect();

    let origin = DVec3::from(pixels.positions[members[0] as usize]);
    let (mut weight, mut area) = (0.0, 0.0_f32);
    let (mut position, mut normal, mut colour) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
    let mut centre = DVec2::ZERO;
    let mut features = vec![0.0_f64; pixels.channels];
    for &(i, place) in &seen {
        let share = confidence(i);
        weight += share;
        area += f32::from(u8::from(view_of(i) == home));
        position += share * (DVec3::from(pixels.positions[i as usize]) - origin);
        normal += share * DVec3::from(pixels.normals[i as usize].map(f64::from));
        let image = views[view_of(i)].image();
        let rgb = image.pixel(pixel_of(i) % image.width(), pixel_of(i) / image.width());
        colour += share * DVec3::from(rgb.map(f64::from));
        centre += share * place;
        let values = &pixels.features[i as usize * pixels.channels..][..pixels.channels];
        features.iter_mut().zip(values).for_each(|(sum, &value)| *sum += share * f64::from(value));
    }
    let position = origin + position / weight;
    let centre = centre / weight;
    let mut spread = [0.0; 3];
    for &(i, place) in &seen {
        let (share, off) = (confidence(i) / weight, place - centre);
        [off.x * off.x, off.x * off.y, off.y * off.y]
            .iter()
            .zip(&mut spread)
            .for_each(|(v, sum)| *sum += share * v);
    }
    let distance = |i: u32| DVec3::from(pixels.positions[i as usize]).distance_squared(position);
    let home_members = members.iter().copied().filter(|&i| view_of(i) == home);
    let pixel =
        home_members.min_by(|&i, &j| distance(i).total_cmp(&distance(j))).unwrap_or(members[0]) as usize;
    // A convex set's mean is in front of the camera, but for rounding.
    let depth = Some(camera.to_camera(position).z).filter(|&z| z > 0.0);
    let depth = depth.unwrap_or_else(|| f64::from(pixels.depths[pixel]));
    let own_normal = DVec3::from(pixels.normals[pixel].map(f64::from));
    let middle = camera.project(position).unwrap_or(centre);
    let [xx, xy, yy] = spread.map(|v| v as f32);
    Voxel {
        pixel,
        position,
        normal: normal.try_normalize().unwrap_or(own_normal),
        depth,
        cell: Cell {
            area,
            centre: middle.as_vec2().to_array(),
            covariance: [xx + PIXEL_VARIANCE, xy, yy + PIXEL_VARIANCE],
            colour: (colour / weight).as_vec3().to_array(),
            inverse_depth: (1.0 / depth) as f32,
        },
        features: features.iter().map(|sum| (sum / weight) as f32).collect(),
    }
}

/// `count` groups of points that share a voxel, or a half of one, or one group per point if those are fewer; ascending
/// places in each.
fn groups(points: &[[f64; 3]], footprints: &[f32], count: usize) -> Vec<Vec<u32>> {
    if points.is_empty() {
        return Vec::new();
    }
    let grid = Grid::around(points);
    let size = grid.solve(points, footprints, count);
    let mut keyed: Vec<(u64, u32)> =
        points.par_iter().map(|&p| grid.key(p, size)).zip(0u32..points.len() as u32).collect();
    keyed.par_sort_unstable();
    let mut groups: Vec<Vec<u32>> =
        keyed.chunk_by(|a, b| a.0 == b.0).map(|voxel| voxel.iter().map(|&(_, i)| i).collect()).collect();
    while groups.len() < count.min(points.len()) {
        let mut fullest: Vec<usize> = (0..groups.len()).filter(|&i| groups[i].len() > 1).collect();
        fullest.sort_by_key(|&i| (std::cmp::Reverse(groups[i].len()), groups[i][0]));
        fullest.truncate(count - groups.len());
        for i in fullest {
            let half = halve(&mut groups[i], points);
            groups.push(half);
        }
    }
    groups
}

/// Takes the upper half of a group of several points, along the axis on which it is longest.
fn halve(group: &mut Vec<u32>, points: &[[f64; 3]]) -> Vec<u32> {
    let point = |i: u32| DVec3::from(points[i as usize]);
    let bounds = group
        .iter()
        .fold((point(group[0]), point(group[0])), |(low, high), &i| (low.min(point(i)), high.max(point(i))));
    let axis = (bounds.1 - bounds.0).max_position();
    group.sort_by(|&i, &j| point(i)[axis].total_cmp(&point(j)[axis]).then(i.cmp(&j)));
    let mut upper = group.split_off(group.len() / 2);
    group.sort_unstable();
    upper.sort_unstable();
    upper
}

/// Where a grid begins, and its finest and coarsest voxel.
struct Grid {
    corner: DVec3,
    finest: f64,
    coarsest: f64,
}

impl Grid {
    fn around(points: &[[f64; 3]]) -> Self {
        let first = DVec3::from(points[0]);
        let bounds =
            points.iter().fold((first, first), |(low, high), &p| (low.min(p.into()), high.max(p.into())));
        // A set without extent is one voxel of any size.
        let extent = (bounds.1 - bounds.0).max_element().max(f64::MIN_POSITIVE * 1e30);
        Self { corner: bounds.0, finest: extent / f64::from(1u32 << (BITS - 1)), coarsest: extent * 2.0 }
    }

    /// The voxel of a point, as one number.
    fn key(&self, point: [f64; 3], size: f64) -> u64 {
        let place = (DVec3::from(point) - self.corner) / size;
        place.to_array().iter().fold(0, |key, &place| key << BITS | place as u64)
    }

    /// How many voxels have points in them.
    fn count(&self, points: &[[f64; 3]], size: f64) -> usize {
        let mut keys: Vec<u64> = points.par_iter().map(|&point| self.key(point, size)).collect();
        keys.par_sort_unstable();
        keys.chunk_by(|a, b| a == b).count()
    }

    /// A size that gives at most `count` voxels, and few less if there is one.
    fn solve(&self, points: &[[f64; 3]], footprints: &[f32], count: usize) -> f64 {
        if count >= points.len() {
            return self.finest;
        }
        let (mut low, mut high) = (self.finest, self.coarsest);
        let mut middle = footprints.to_vec();
        let (_, &mut typical, _) = middle.select_nth_unstable_by(footprints.len() / 2, f32::total_cmp);
        // Points on surfaces: their voxels fall with the square of the size.
        let mut guess = f64::from(typical) * (points.len() as f64 / count as f64).sqrt();
        for trial in 0..TRIALS {
            // Every third the middle of what is left, in case that law fails.
            let ratio = (high / low).sqrt();
            let size = if trial % 3 == 2 || !(low..high).contains(&guess) { low * ratio } else { guess };
            let found = self.count(points, size);
            if found > count {
                low = size;
            } else {
                high = size;
                if found + count / SLACK >= count {
                    break;
                }
            }
            // Aims a little below the count.
            guess = size * (found as f64 / count as f64).sqrt() * (1.0 + 0.25 / SLACK as f64);
        }
        high
    }
}

#[cfg(test)]
mod tests;
