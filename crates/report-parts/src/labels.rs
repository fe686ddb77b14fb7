//! Places labels beside the points of a plot so that none overlaps another label, a point or a line.

/// A rectangle in pixels: left, top, right, bottom.
pub type Rectangle = [i32; 4];

/// Height of a line of text, pixels.
const HEIGHT: i32 = 12;
/// Width of a letter, pixels, on the safe side: nobody measures the reader's font.
const LETTER: f64 = 5.4;
/// Half the side of a point's mark, its ring included, pixels.
const MARK: i32 = 8;
/// The same of a piece of a line, and how far these are apart.
const PIECE: i32 = 3;
/// Distances between a point and its name that are tried, pixels.
const GAPS: [i32; 10] = [9, 14, 20, 30, 42, 56, 72, 90, 110, 132];
/// How much worse a name that cannot be read is than a hidden piece of a line.
const UNREADABLE: i64 = 50;
/// From here on a line leads to the name.
const FAR: i32 = 20;

/// Where a name goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Placed {
    /// Upper left corner of the text, from its point.
    pub corner: (i32, i32),
    /// Where a line from the point to the text ends, from the point, if there is to be one.
    pub leader: Option<(i32, i32)>,
}

/// Places for names at their points, in this order; names avoid the points of all `lines` (one alone is a line of one point), what is
/// drawn between these, and each other, and stay within `bounds`. Where there is no room at all, the place that hides least is taken.
pub fn place(names: &[(&str, (i32, i32))], lines: &[Vec<(i32, i32)>], bounds: Rectangle) -> Vec<Placed> {
    let around_point = |half: i32| move |(x, y): (i32, i32)| [x - half, y - half, x + half, y + half];
    let mut taken: Vec<Rectangle> = lines.iter().flatten().copied().map(around_point(MARK)).collect();
    for pair in lines.iter().flat_map(|line| line.windows(2)) {
        taken.extend(pieces(pair[0], pair[1]).map(around_point(PIECE)));
    }
    let (mut all, mut texts) = (Vec::with_capacity(names.len()), Vec::new());
    for &(name, (x, y)) in names {
        let width = (name.chars().count() as f64 * LETTER).ceil() as i32;
        let candidates = GAPS.iter().flat_map(|&gap| around(gap, width).map(|corner| (gap, corner)));
        let text = |(dx, dy): (i32, i32)| [x + dx, y + dy, x + dx + width, y + dy + HEIGHT];
        let end = |(dx, dy): (i32, i32)| (0.clamp(dx, dx + width), 0.clamp(dy, dy + HEIGHT));
        let leader = |gap: i32, corner: (i32, i32)| (gap >= FAR).then(|| end(corner));
        let cost = |&(gap, corner): &(i32, (i32, i32))| {
            let text = text(corner);
            let outside =
                text[0] < bounds[0] || text[1] < bounds[1] || text[2] > bounds[2] || text[3] > bounds[3];
            let hidden: i64 = taken.iter().map(|other| overlap(text, *other)).sum();
            let written_over: i64 = texts.iter().map(|other| overlap(text, *other)).sum();
            let along = leader(gap, corner).into_iter().flat_map(|(dx, dy)| pieces((x, y), (x + dx, y + dy)));
            let crossed: i64 = along
                .flat_map(|point| texts.iter().map(move |text| overlap(around_point(1)(point), *text)))
                .sum();
            hidden + UNREADABLE * (written_over + crossed) + if outside { 1_000_000 } else { 0 }
        };
        // The first of equals: the nearest.
        let Some((gap, corner)) = candidates.min_by_key(cost) else { continue };
        let leader = leader(gap, corner);
        taken.extend(
            leader.into_iter().flat_map(|(dx, dy)| pieces((x, y), (x + dx, y + dy))).map(around_point(PIECE)),
        );
        texts.push(text(corner));
        all.push(Placed { corner, leader });
    }
    all
}

/// Points along a line between two.
fn pieces(from: (i32, i32), to: (i32, i32)) -> impl Iterator<Item = (i32, i32)> {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let n = dx.abs().max(dy.abs()) / PIECE;
    (1..n).map(move |i| (from.0 + dx * i / n, from.1 + dy * i / n))
}

/// Corners of a text around a point, so far away: beside, above and below it, then in between.
fn around(gap: i32, width: i32) -> [(i32, i32); 16] {
    let (middle, slant, flat) = (-HEIGHT / 2, gap * 7 / 10, gap * 4 / 10);
    let (left, above) = (|by: i32| -by - width, |by: i32| -by - HEIGHT);
    [
        (gap, middle),
        (slant, above(slant)),
        (slant, slant),
        (left(gap), middle),
        (left(slant), above(slant)),
        (left(slant), slant),
        (-width / 2, above(gap)),
        (-width / 2, gap),
        (gap, above(flat)),
        (gap, flat),
        (left(gap), above(flat)),
        (left(gap), flat),
        (flat, above(gap)),
        (flat, gap),
        (left(flat), above(gap)),
        (left(flat), gap),
    ]
}

/// Area that two rectangles share.
fn overlap(a: Rectangle, b: Rectangle) -> i64 {
    let side = |low: usize, high: usize| i64::from((a[high].min(b[high]) - a[low].max(b[low])).max(0));
    side(0, 2) * side(1, 3)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn boxes(names: &[(&str, (i32, i32))], placed: &[Placed]) -> Vec<Rectangle> {
        let rectangle = |((name, (x, y)), placed): (&(&str, (i32, i32)), &Placed)| {
            let (left, top) = (x + placed.corner.0, y + placed.corner.1);
            [left, top, left + (name.len() as f64 * LETTER).ceil() as i32, top + HEIGHT]
        };
        names.iter().zip(placed).map(rectangle).collect()
    }

    #[test]
    fn names_of_points_in_one_place_lie_apart_and_on_no_point() {
        let names: Vec<(&str, (i32, i32))> =
            ["K=0", "K=5", "bernoulli", "refine-60", "half-size", "pixel-aligned"]
                .iter()
                .enumerate()
                .map(|(i, &name)| (name, (200 + i as i32 % 2, 100)))
                .collect();
        let line = vec![(100, 100), (230, 100), (230, 180)];
        let marks: Vec<(i32, i32)> = names.iter().map(|(_, point)| *point).chain(line.clone()).collect();
        let lines: Vec<Vec<(i32, i32)>> = names.iter().map(|(_, point)| vec![*point]).chain([line]).collect();
        let bounds = [50, 10, 400, 300];
        let placed = place(&names, &lines, bounds);
        let boxes = boxes(&names, &placed);
        for (i, a) in boxes.iter().enumerate() {
            assert!(boxes[..i].iter().all(|b| overlap(*a, *b) == 0), "{}", names[i].0);
            assert!(
                marks.iter().all(|&(x, y)| overlap(*a, [x - 3, y - 3, x + 3, y + 3]) == 0),
                "{}",
                names[i].0
            );
            assert!(overlap(*a, [110, 99, 220, 101]) == 0, "{} lies on the line", names[i].0);
            assert!(a[0] >= bounds[0] && a[2] <= bounds[2] && a[1] >= bounds[1] && a[3] <= bounds[3]);
        }
        assert!(placed[0].leader.is_none() && placed.iter().any(|placed| placed.leader.is_some()));
    }

    #[test]
    fn a_name_without_room_is_still_shown() {
        let placed = place(&[("a long name", (5, 5))], &[vec![(5, 5)]], [0, 0, 10, 10]);
        assert_eq!(placed.len(), 1);
    }
}
