//! Parts of all plots: size, colours, axes, lines with marks, the legend.

use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Width and height, pixels.
pub const SIZE: (u32, u32) = (960, 460);
/// Width of the legend beside a chart, pixels.
const LEGEND: u32 = 216;
/// Colours of series that are told apart by people who do not see red and green (Okabe & Ito, and a violet).
pub const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(73, 0, 146),
    RGBColor(240, 228, 66),
];
/// Colour of what belongs to no series.
pub const NEUTRAL: RGBColor = RGBColor(90, 90, 90);

/// A chart on SVG.
pub type Chart<'a, 'b, X, Y> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<X, Y>>;
/// A part of the picture.
pub type Area<'b> = DrawingArea<SVGBackend<'b>, Shift>;
/// Series by name, as the legend lists them.
pub type Names = Vec<(String, ShapeStyle)>;
/// What drawing may give.
pub type Drawn<T = ()> = Result<T, Box<dyn std::error::Error>>;

/// Draws into a string.
pub fn svg(size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Drawn) -> String {
    let mut svg = String::new();
    let drawn = {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        let filled = area.fill(&WHITE).map_err(Into::into);
        filled.and_then(|()| draw(&area)).and_then(|()| Ok(area.present()?))
    };
    match drawn {
        Ok(()) => svg,
        // Writing into a string does not fail, and the coordinates are finite.
        Err(error) => unreachable!("a plot is drawn into memory: {error}"),
    }
}

/// The style of a series.
pub fn style(colour: RGBColor, stroke_width: u32) -> ShapeStyle {
    ShapeStyle { color: colour.to_rgba(), filled: true, stroke_width }
}

/// A logarithmic axis of counts, marked at 1, 2 and 5 times the powers of ten.
pub struct Counts(std::ops::Range<f64>);

impl Counts {
    /// An axis around the positive ones of some numbers.
    pub fn around(values: impl Iterator<Item = f64>) -> Self {
        let around = range(values.filter(|value| *value > 0.0).map(f64::log10), 0.05);
        Self(10f64.powf(around.start)..10f64.powf(around.end))
    }
}

impl Ranged for Counts {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = (value / self.0.start).ln() / (self.0.end / self.0.start).ln();
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        let decades = self.0.start.log10().floor() as i32..=self.0.end.log10().floor() as i32;
        let marks = decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|mark| mark * 10f64.powi(decade)));
        marks.filter(|mark| self.0.contains(mark)).collect()
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.0.clone()
    }
}

impl ValueFormatter<f64> for Counts {
    fn format(count: &f64) -> String {
        match *count {
            million if million >= 1e6 => format!("{}M", million / 1e6),
            thousand if thousand >= 1e3 => format!("{}k", thousand / 1e3),
            few => few.to_string(),
        }
    }
}

/// An axis of seconds: logarithmic where a few slow points would press all others into a corner.
pub enum Seconds {
    /// From one number to another.
    Linear(RangedCoordf64),
    /// By powers of ten.
    Logarithmic(Counts),
}

/// Where three quarters of the points lie in this share of a linear axis, it is a logarithmic one.
const CORNER: f64 = 0.2;

impl Seconds {
    /// An axis around some numbers; a linear one begins at `least` or below the smallest, at 0 at the lowest.
    pub fn around(values: impl Iterator<Item = f64>, least: f64) -> Self {
        let mut sorted: Vec<f64> = values.filter(|value| value.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        if let (Some(&first), Some(&last)) = (sorted.first(), sorted.last())
            && first > 0.0
            && sorted[(sorted.len() - 1) * 3 / 4] < CORNER * last
        {
            return Self::Logarithmic(Counts::around(sorted.into_iter()));
        }
        let around = range(sorted.into_iter(), 0.08);
        Self::Linear((around.start.min(least).max(0.0)..around.end).into())
    }
}

impl Ranged for Seconds {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        match self {
            Self::Linear(axis) => axis.map(value, limit),
            Self::Logarithmic(axis) => axis.map(value, limit),
        }
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        match self {
            Self::Linear(axis) => axis.key_points(hint),
            Self::Logarithmic(axis) => axis.key_points(hint),
        }
    }

    fn range(&self) -> std::ops::Range<f64> {
        match self {
            Self::Linear(axis) => axis.range(),
            Self::Logarithmic(axis) => axis.range(),
        }
    }
}

impl ValueFormatter<f64> for Seconds {
    fn format(seconds: &f64) -> String {
        let text = format!("{seconds:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    }
}

/// Axes with a name each.
///
/// # Errors
/// If the backend of plotters fails; one that draws into memory does not.
pub fn axes<X, Y>(chart: &mut Chart<'_, '_, X, Y>, x: &str, y: &str) -> Drawn
where
    X: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc(x)
        .y_desc(y)
        .label_style(("sans-serif", 14))
        .axis_desc_style(("sans-serif", 15))
        .draw()?;
    Ok(())
}

/// An area for a chart, and one beside it for its legend, which would hide points within.
pub fn beside<'b>(area: &Area<'b>) -> (Area<'b>, Area<'b>) {
    area.split_horizontally(SIZE.0 - LEGEND)
}

/// A chart to be, with the room for its axes.
pub fn chart_on<'a, 'b>(area: &'a Area<'b>) -> ChartBuilder<'a, 'b, SVGBackend<'b>> {
    let mut builder = ChartBuilder::on(area);
    builder.margin(12).x_label_area_size(40).y_label_area_size(64);
    builder
}

/// A line with a mark at each point, unless their size is 0; its name goes to `names`.
///
/// # Errors
/// If the backend of plotters fails; one that draws into memory does not.
pub fn line<X, Y>(
    chart: &mut Chart<'_, '_, X, Y>,
    names: &mut Names,
    name: &str,
    points: &[(f64, f64)],
    style: ShapeStyle,
    mark: u32,
) -> Drawn
where
    X: Ranged<ValueType = f64>,
    Y: Ranged<ValueType = f64>,
{
    chart.draw_series(std::iter::once(PathElement::new(points.to_vec(), style)))?;
    names.push((name.to_owned(), style));
    if mark > 0 {
        marks(chart, points, style, mark)?;
    }
    Ok(())
}

/// Marks without a line.
///
/// # Errors
/// If the backend of plotters fails; one that draws into memory does not.
pub fn marks<X, Y>(
    chart: &mut Chart<'_, '_, X, Y>,
    points: &[(f64, f64)],
    style: ShapeStyle,
    size: u32,
) -> Drawn
where
    X: Ranged<ValueType = f64>,
    Y: Ranged<ValueType = f64>,
{
    chart.draw_series(points.iter().map(|&point| Circle::new(point, size, style)))?;
    Ok(())
}

/// The names of the series, one below the other.
///
/// # Errors
/// If the backend of plotters fails; one that draws into memory does not.
pub fn legend(area: &Area<'_>, names: &Names) -> Drawn {
    for (i, (name, style)) in names.iter().enumerate() {
        let y = 22 + 20 * i as i32;
        area.draw(&PathElement::new([(2, y), (22, y)], *style))?;
        let font = ("sans-serif", 13).into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
        area.draw(&Text::new(name.clone(), (28, y), font))?;
    }
    Ok(())
}

/// Lowest and highest of the finite numbers, with a margin of this share on both sides; 0 to 1 where there are none.
pub fn range(values: impl Iterator<Item = f64>, margin: f64) -> std::ops::Range<f64> {
    let finite = values.filter(|value| value.is_finite());
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    if low > high {
        return 0.0..1.0;
    }
    let margin = (margin * (high - low)).max(1e-6);
    low - margin..high + margin
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_series_look_alike_and_none_like_what_belongs_to_no_series() {
        let all = [&COLOURS[..], &[NEUTRAL]].concat();
        let distance = |a: RGBColor, b: RGBColor| {
            [(a.0, b.0), (a.1, b.1), (a.2, b.2)]
                .into_iter()
                .map(|(a, b)| i32::from(a.abs_diff(b)))
                .sum::<i32>()
        };
        for (i, a) in all.iter().enumerate() {
            assert!(all[..i].iter().all(|b| distance(*a, *b) > 60), "{a:?}");
        }
    }

    #[test]
    fn one_slow_point_does_not_press_the_others_into_a_corner() {
        let quick = [1.0, 1.5, 2.0, 2.5, 3.0];
        let apart = |axis: &Seconds| axis.map(&3.0, (0, 600)) - axis.map(&1.0, (0, 600));
        let linear = Seconds::around(quick.into_iter(), f64::INFINITY);
        assert!(matches!(linear, Seconds::Linear(_)) && linear.range().start > 0.5);
        assert_eq!(Seconds::around(quick.into_iter(), 0.0).range().start, 0.0);
        let logarithmic = Seconds::around(quick.into_iter().chain([70.0]), 0.0);
        assert!(matches!(logarithmic, Seconds::Logarithmic(_)) && apart(&logarithmic) > 120);
        let marks: Vec<String> = logarithmic.key_points(9).iter().map(Seconds::format).collect();
        assert_eq!(marks, ["1", "2", "5", "10", "20", "50"]);
        assert_eq!(Seconds::format(&0.05), "0.05");
        // A time of nothing has no place on a logarithmic axis.
        let with_nothing = Seconds::around(quick.into_iter().chain([0.0, 70.0]), 0.0);
        assert!(matches!(with_nothing, Seconds::Linear(_)));
        assert_eq!(Seconds::around(std::iter::empty(), 0.0).range(), 0.0..1.0);
    }

    #[test]
    fn counts_are_marked_once_each_within_their_range() {
        let axis = Counts::around([1e3, 0.0, f64::NAN, 3e5].into_iter());
        let marks = axis.key_points(9);
        assert_eq!(marks, [1e3, 2e3, 5e3, 1e4, 2e4, 5e4, 1e5, 2e5]);
        assert_eq!(marks.iter().map(Counts::format).collect::<Vec<_>>()[..4], ["1k", "2k", "5k", "10k"]);
        let steps: Vec<i32> = [1e3, 1e4, 1e5].iter().map(|count| axis.map(count, (0, 600))).collect();
        assert!((steps[2] - steps[1] - (steps[1] - steps[0])).abs() <= 1, "{steps:?}");
        assert!(steps[0] > 0 && axis.map(&3e5, (0, 600)) < 600);
    }
}
