//! The paper's tables (SparseSplat, CVPR 2026), beside the points of a sweep.

use super::summary::{Row, Summary};
use report_parts::{Table, count, lpips_column, number};
use serde::{Serialize, Serializer};
use sparsesplat::Stage;

/// A table of the paper.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum PaperTable {
    /// "Quantitative comparison on the DL3DV dataset".
    Main,
    /// "Cross-dataset generalization results on the Replica dataset".
    Replica,
    /// "Inference Time Breakdown", of the supplement.
    Runtime,
    /// "Rendering Efficiency vs. Gaussian Count", a figure of the supplement.
    Frames,
    /// "Quantitative comparison of Gaussian primitive counts", of the supplement.
    Primitives,
}

/// A column: key in JSON, head, digits, and how it is read off a point. Without digits it is a count.
struct Column(&'static str, &'static str, Option<usize>, fn(&Row) -> f64);

const PSNR: Column = Column("psnr_held_out", "PSNR", Some(2), |row| row.psnr_held_out);
const SSIM: Column = Column("ssim_held_out", "SSIM", Some(3), |row| row.ssim_held_out);
const LPIPS: Column =
    Column("lpips_held_out", "LPIPS", Some(3), |row| row.lpips_held_out.unwrap_or(f64::NAN));
const GAUSSIANS: Column = Column("gaussians", "Gaussians", None, |row| row.gaussians);
const SECONDS: Column = Column("seconds_to_gaussians", "seconds", Some(3), |row| row.seconds_to_gaussians);
const FRAMES: Column = Column("frames_per_second", "frames/s", Some(1), |row| row.frames_per_second);
const MAIN: [Column; 5] = [PSNR, SSIM, LPIPS, GAUSSIANS, SECONDS];
const REPLICA: [Column; 3] = [PSNR, SSIM, LPIPS];
/// Milliseconds. `other` is what the paper does not list, `between` what no stage counts: with it a row adds up.
const RUNTIME: [Column; 7] = [
    Column("milliseconds_backbone", "backbone", Some(1), |row| 1e3 * row.seconds.stages[Stage::Backbone]),
    Column("milliseconds_sampling", "sampling", Some(1), |row| 1e3 * row.seconds.stages[Stage::Sampling]),
    Column("milliseconds_knn", "KNN", Some(1), |row| 1e3 * row.seconds.stages[Stage::Knn]),
    Column("milliseconds_attention", "head", Some(1), |row| 1e3 * row.seconds.stages[Stage::Head]),
    Column("milliseconds_other", "other", Some(1), |row| 1e3 * other(row)),
    Column("milliseconds_between", "between", Some(1), |row| 1e3 * between(row)),
    Column("milliseconds_total", "total", Some(1), |row| 1e3 * row.seconds_to_gaussians),
];

/// Stages that the paper lists.
const LISTED: [Stage; 4] = [Stage::Backbone, Stage::Sampling, Stage::Knn, Stage::Head];

/// Stages that the paper does not list, seconds.
fn other(row: &Row) -> f64 {
    let all: f64 = row.seconds.by_name().map(|(_, seconds)| seconds).sum();
    all - row.seconds.render - listed(row)
}

fn listed(row: &Row) -> f64 {
    LISTED.map(|stage| row.seconds.stages[stage]).iter().sum()
}

/// Wall time that is in no stage, seconds.
fn between(row: &Row) -> f64 {
    row.seconds_to_gaussians - (other(row) + listed(row))
}

/// A row: what kind of method, our point (allocation, count; without one it is pixel-aligned), the paper's row and its figures by
/// column, NaN where it has none.
struct Pair(&'static str, Option<(&'static str, Option<usize>)>, Option<(&'static str, &'static [f64])>);

const fn ours(kind: &'static str, allocation: &'static str, count: usize) -> Pair {
    Pair(kind, Some((allocation, Some(count))), None)
}

const fn theirs(kind: &'static str, name: &'static str, figures: &'static [f64]) -> Pair {
    Pair(kind, None, Some((name, figures)))
}

const fn both(
    kind: &'static str,
    allocation: &'static str,
    count: Option<usize>,
    name: &'static str,
    figures: &'static [f64],
) -> Pair {
    Pair(kind, Some((allocation, count)), Some((name, figures)))
}

const ALIGNED: &str = "pixel-aligned";
const MERGED: &str = "post-processed";
const VOXELS: &str = "voxels";
const ADAPTIVE: &str = "adaptive";
const DRAWN: &str = "other sampling";

impl PaperTable {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Main, Self::Replica, Self::Runtime, Self::Frames, Self::Primitives];

    /// What the table is about.
    #[must_use]
    pub fn title(self) -> &'static str {
        match self {
            Self::Main => "Methods by count (the paper: DL3DV)",
            Self::Replica => "One per pixel against 150k (the paper: Replica, never trained on)",
            Self::Runtime => "Where the time goes, milliseconds",
            Self::Frames => "Frames per second over the number of Gaussians",
            Self::Primitives => "How many Gaussians, beside mapping systems",
        }
    }

    /// Whether all allocations are in it, or ours and the pixel-aligned one.
    #[must_use]
    pub fn compares_allocations(self) -> bool {
        self == Self::Main
    }

    fn columns(self) -> &'static [Column] {
        match self {
            Self::Main => &MAIN,
            Self::Replica => &REPLICA,
            Self::Runtime => &RUNTIME,
            Self::Frames => &[GAUSSIANS, FRAMES],
            Self::Primitives => &[GAUSSIANS],
        }
    }

    fn rows(self) -> Vec<Pair> {
        const NONE: f64 = f64::NAN;
        match self {
            Self::Main => vec![
                theirs(ALIGNED, "MVSplat", &[22.95, 0.774, 0.192, 688e3, 0.260]),
                both(ALIGNED, ALIGNED, None, "DepthSplat", &[24.17, 0.816, 0.152, 688e3, 0.128]),
                theirs(MERGED, "Long-LRM", &[20.92, 0.627, 0.265, 200e3, 0.115]),
                both(MERGED, "merged", Some(150_000), "GGN", &[20.23, 0.570, 0.268, 162e3, 0.320]),
                ours(MERGED, "merged", 100_000),
                ours(MERGED, "merged", 40_000),
                ours(MERGED, "merged", 10_000),
                theirs(VOXELS, "AnySplat", &[17.45, 0.471, 0.320, 608e3, 0.378]),
                theirs(VOXELS, "AnySplat", &[17.34, 0.463, 0.330, 528e3, 0.384]),
                theirs(VOXELS, "AnySplat", &[16.14, 0.417, 0.390, 393e3, 0.415]),
                theirs(VOXELS, "AnySplat", &[12.22, 0.309, 0.519, 222e3, 0.441]),
                ours(VOXELS, "voxel-aligned", 150_000),
                both(VOXELS, "voxel-aligned", Some(100_000), "AnySplat", &[8.91, 0.239, 0.618, 113e3, 0.473]),
                ours(VOXELS, "voxel-aligned", 40_000),
                ours(VOXELS, "voxel-aligned", 10_000),
                ours(DRAWN, "random", 150_000),
                ours(DRAWN, "random", 40_000),
                ours(DRAWN, "random", 10_000),
                ours(DRAWN, "laplacian", 150_000),
                ours(DRAWN, "laplacian", 40_000),
                ours(DRAWN, "laplacian", 10_000),
                both(ADAPTIVE, "entropy", Some(150_000), "Ours", &[24.20, 0.817, 0.168, 150e3, 0.398]),
                both(ADAPTIVE, "entropy", Some(100_000), "Ours", &[23.95, 0.786, 0.189, 100e3, 0.192]),
                both(ADAPTIVE, "entropy", Some(40_000), "Ours", &[22.65, 0.737, 0.251, 40e3, 0.111]),
                both(ADAPTIVE, "entropy", Some(10_000), "Ours", &[21.29, 0.665, 0.321, 10e3, 0.105]),
            ],
            Self::Replica => vec![
                theirs(ALIGNED, "MVSplat", &[19.13, 0.628, 0.423]),
                both(ALIGNED, ALIGNED, None, "DepthSplat", &[26.47, 0.836, 0.175]),
                both(ADAPTIVE, "entropy", Some(150_000), "Ours-150k", &[26.64, 0.846, 0.180]),
            ],
            Self::Runtime => {
                const TEN: [f64; 7] = [89.68, 1.66, 3.21, 5.95, NONE, NONE, 100.50];
                const FORTY: [f64; 7] = [89.68, 1.82, 14.87, 15.04, NONE, NONE, 121.41];
                const HUNDRED: [f64; 7] = [89.68, 2.16, 52.02, 65.18, NONE, NONE, 209.04];
                const MOST: [f64; 7] = [89.68, 2.08, 219.64, 103.31, NONE, NONE, 414.71];
                vec![
                    both(ADAPTIVE, "entropy", Some(10_000), "Ours-10k", &TEN),
                    both(ADAPTIVE, "entropy", Some(40_000), "Ours-40k", &FORTY),
                    both(ADAPTIVE, "entropy", Some(100_000), "Ours-100k", &HUNDRED),
                    both(ADAPTIVE, "entropy", Some(150_000), "Ours-150k", &MOST),
                ]
            }
            Self::Frames => vec![
                both(ALIGNED, ALIGNED, None, "pixel-aligned", &[688e3, 71.9]),
                both(ADAPTIVE, "entropy", Some(150_000), "150k", &[150e3, 208.6]),
                ours(ADAPTIVE, "entropy", 100_000),
                both(ADAPTIVE, "entropy", Some(40_000), "40k", &[40e3, NONE]),
                both(ADAPTIVE, "entropy", Some(10_000), "10k", &[10e3, NONE]),
            ],
            Self::Primitives => vec![
                theirs("Replica office0", "GS-ICP-SLAM, RGB-D", &[1.57e6]),
                theirs("Replica office0", "Photo-SLAM, RGB-D", &[0.08e6]),
                theirs("Replica office0", "Photo-SLAM, monocular", &[0.08e6]),
                theirs("TUM fr1/desk", "GS-ICP-SLAM, RGB-D", &[1.56e6]),
                theirs("TUM fr1/desk", "SplaTAM, RGB-D", &[0.96e6]),
                theirs("TUM fr1/desk", "Gaussian-SLAM, RGB-D", &[0.70e6]),
                theirs("TUM fr1/desk", "MonoGS, monocular", &[0.04e6]),
                theirs("TUM fr1/desk", "Photo-SLAM, monocular", &[0.02e6]),
                theirs("TUM fr3/office", "GS-ICP-SLAM, RGB-D", &[1.09e6]),
                theirs("TUM fr3/office", "Gaussian-SLAM, RGB-D", &[1.04e6]),
                theirs("TUM fr3/office", "SplaTAM, RGB-D", &[0.79e6]),
                theirs("TUM fr3/office", "MonoGS, monocular", &[0.03e6]),
                theirs("TUM fr3/office", "Photo-SLAM, monocular", &[0.01e6]),
                both("one window", ALIGNED, None, "DepthSplat", &[688e3]),
                both("one window", "entropy", Some(40_000), "Ours", &[40e3]),
                both("one window", "entropy", Some(10_000), "Ours", &[10e3]),
            ],
        }
    }

    /// What has to be known to read the table.
    fn notes(self, lpips_network: Option<&str>) -> Vec<String> {
        let lpips = match lpips_network {
            Some("vgg") => "LPIPS by VGG16, as the paper's.".to_owned(),
            Some(network) => {
                format!("Our LPIPS is by {network}, the paper's by VGG16; the two are not comparable.")
            }
            None => "Our LPIPS was not measured: no weights were given.".to_owned(),
        };
        let text = |text: &str| text.to_owned();
        match self {
            Self::Main => vec![
                text(
                    "The paper's figures are for DL3DV's 140 test scenes at 256x448, with each system's own training, on a GPU. Ours are \
                     for the stated data, with one backbone and one head for all rows: only the allocation differs. Looks and correction are ours, not the paper's; merged \
                     Gaussians have no anchors of their own, so they are not corrected.",
                ),
                lpips,
            ],
            Self::Replica => {
                vec![
                    text("The paper's figures are for 28 scenes of Replica, ours for the stated data."),
                    lpips,
                ]
            }
            Self::Runtime => vec![text(
                "Head: the paper's is its attention. Other: loading, exposure, far shell, back-projection, feedback, decoding, looks, correction and writing, which the paper does not list. Between: \
                 wall time outside of all stages. The paper's times are for a GPU.",
            )],
            Self::Frames => vec![text(
                "The paper gives 71.9 and 208.6 frames per second, and more than 600 from 10k to 40k, on a GPU. Ours are for the stated device.",
            )],
            Self::Primitives => vec![text(
                "The figures of mapping systems are for whole sequences, as the paper takes them from CaRtGS. The paper's own figures and ours are for \
                 one window only; a mapping system would add that number for every window of keyframes.",
            )],
        }
    }
}

/// A table of the paper with a sweep's points beside.
#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    /// Which one.
    pub table: PaperTable,
    /// The network of our LPIPS; the paper's is VGG16.
    pub lpips_network: Option<String>,
    /// Its rows.
    pub rows: Vec<Compared>,
    /// What has to be known to read it.
    pub notes: Vec<String>,
}

/// A row: what was measured here, and what the paper says.
#[derive(Debug, Clone, Serialize)]
pub struct Compared {
    /// What kind of method it is.
    pub kind: &'static str,
    /// Our point; none where nothing here stands for the paper's row.
    pub point: Option<String>,
    /// Our figures by column; none where the point was not measured.
    pub ours: Option<Figures>,
    /// The paper's name for its row.
    pub paper_row: Option<&'static str>,
    /// The paper's figures by column.
    pub paper: Option<Figures>,
}

/// Figures by key; in JSON an object, NaN as null.
#[derive(Debug, Clone)]
pub struct Figures(Vec<(&'static str, f64)>);

impl Serialize for Figures {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|&(key, value)| (key, value)))
    }
}

impl Comparison {
    /// A table of the paper beside a sweep; rows with neither a point of the sweep nor a counterpart in the paper are left out.
    #[must_use]
    pub fn new(table: PaperTable, summary: &Summary) -> Self {
        let columns = table.columns();
        let keyed = |value: &dyn Fn(usize) -> f64| {
            Figures(columns.iter().enumerate().map(|(i, column)| (column.0, value(i))).collect())
        };
        let compared = |Pair(kind, ours, paper): Pair| {
            let row = ours.and_then(|(allocation, count)| summary.by_count(allocation, count));
            (row.is_some() || paper.is_some()).then(|| Compared {
                kind,
                point: row.map(|row| row.label.point.clone()),
                ours: row.map(|row| keyed(&|i| columns[i].3(row))),
                paper_row: paper.map(|(name, _)| name),
                paper: paper.map(|(_, figures)| keyed(&|i| figures[i])),
            })
        };
        let rows = table.rows().into_iter().filter_map(compared).collect();
        let lpips_network = summary.lpips_network.clone();
        Self { table, rows, notes: table.notes(lpips_network.as_deref()), lpips_network }
    }

    /// Whether the sweep has a point of it.
    #[must_use]
    pub fn has_ours(&self) -> bool {
        self.rows.iter().any(|row| row.ours.is_some())
    }

    /// As text: our columns, then the paper's.
    #[must_use]
    pub fn to_table(&self) -> Table {
        let columns = self.table.columns();
        let heads = |network: Option<&str>| -> Vec<String> {
            let head = |column: &Column| match column.1 {
                "LPIPS" => lpips_column(network),
                head => head.to_owned(),
            };
            columns.iter().map(head).collect()
        };
        let (ours, papers) = (heads(self.lpips_network.as_deref()), heads(Some("vgg")));
        let head: Vec<&str> = ["kind", "here"]
            .into_iter()
            .chain(ours.iter().map(String::as_str))
            .chain(["paper"])
            .chain(papers.iter().map(String::as_str))
            .collect();
        let mut table = Table::new(&head, 2);
        let cells = |figures: &Option<Figures>| -> Vec<String> {
            let cell = |(i, column): (usize, &Column)| {
                let value = figures.as_ref().map_or(f64::NAN, |figures| figures.0[i].1);
                column.2.map_or_else(|| count(value), |digits| number(value, digits))
            };
            columns.iter().enumerate().map(cell).collect()
        };
        for row in &self.rows {
            let name = row.point.clone().unwrap_or_else(|| "-".to_owned());
            let theirs = row.paper_row.unwrap_or("-").to_owned();
            let mut line = vec![row.kind.to_owned(), name];
            line.extend(cells(&row.ours));
            line.push(theirs);
            line.extend(cells(&row.paper));
            table.push(line);
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::tests::summary;

    #[test]
    fn every_row_has_a_figure_per_column_and_points_that_sweeps_have() {
        let counts = crate::sweep::PAPER_COUNTS;
        for table in PaperTable::ALL {
            for Pair(_, ours, paper) in table.rows() {
                assert!(paper.is_none_or(|(_, figures)| figures.len() == table.columns().len()), "{table:?}");
                assert!(ours.is_none_or(|(_, count)| count.is_none_or(|n| counts.contains(&n))), "{table:?}");
            }
        }
    }

    #[test]
    fn ours_stand_beside_the_papers() {
        // Entropy at 1k and 10k, and one per pixel.
        let summary = summary(&[20.0, 22.8], 22.9);
        let main = Comparison::new(PaperTable::Main, &summary);
        let entry = |name: &str| main.rows.iter().find(|row| row.point.as_deref() == Some(name)).unwrap();
        assert_eq!(entry("entropy-10k").paper.as_ref().unwrap().0[0], ("psnr_held_out", 21.29));
        assert_eq!(entry("entropy-10k").ours.as_ref().unwrap().0[0], ("psnr_held_out", 22.8));
        assert_eq!(entry("pixel-aligned").paper_row, Some("DepthSplat"));
        // What was not measured is shown as the paper's alone, or not at all.
        assert!(main.rows.iter().any(|row| row.paper_row == Some("GGN") && row.ours.is_none()));
        assert!(main.rows.iter().all(|row| row.kind != DRAWN));
        assert_eq!(main.to_table().rows().len(), main.rows.len());
        let json = serde_json::to_value(&main).unwrap();
        assert!(json["rows"][0]["ours"].is_null() && json["rows"][1]["ours"]["lpips_held_out"].is_null());
    }

    #[test]
    fn the_times_of_a_row_add_up() {
        let mut summary = summary(&[20.0, 22.8], 22.9);
        let stage = std::cell::Cell::new(1.0);
        summary.points[1].seconds = evaluate::Seconds::of_each(|_| stage.replace(2.0 * stage.get()));
        let seconds = &summary.points[1].seconds;
        let of_pass: f64 = seconds.by_name().map(|(_, seconds)| seconds).sum::<f64>() - seconds.render;
        summary.points[1].seconds_to_gaussians = of_pass + 0.5;
        let runtime = Comparison::new(PaperTable::Runtime, &summary);
        let figures = &runtime.rows[0].ours.as_ref().unwrap().0;
        let (total, parts) = figures.split_last().unwrap();
        assert!((parts.iter().map(|(_, ms)| ms).sum::<f64>() - total.1).abs() < 1e-9, "{figures:?}");
        // A stage that no column counts would be in it.
        assert_eq!(*parts.last().unwrap(), ("milliseconds_between", 500.0));
    }
}
