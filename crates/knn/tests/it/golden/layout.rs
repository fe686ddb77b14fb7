//! Reads golden neighbours (layout: `fixtures/knn/README.md`) and compares.

use knn::Neighbors;
use safetensors::{SafeTensorError, SafeTensors};
use std::fmt;

pub(crate) const K: usize = 20;

pub(crate) struct GoldenSet {
    pub(crate) name: String,
    pub(crate) points: Vec<[f32; 3]>,
    idx: Vec<i32>,
    d2: Vec<f32>,
    tie: Vec<u8>,
}

/// What differs from the golden neighbours.
pub(crate) struct Report {
    wrong_k: bool,
    wrong_indices: usize,
    compared_indices: usize,
    ties: usize,
    worst_distance: f64,
}

pub(crate) fn read(bytes: &[u8]) -> Result<Vec<GoldenSet>, SafeTensorError> {
    let file = SafeTensors::deserialize(bytes)?;
    let words = |name: &str| -> Result<Vec<[u8; 4]>, SafeTensorError> {
        let data = file.tensor(name)?.data();
        Ok(data.chunks_exact(4).map(|w| [w[0], w[1], w[2], w[3]]).collect())
    };
    let floats = |name: &str| Ok::<_, SafeTensorError>(words(name)?.into_iter().map(f32::from_le_bytes));
    let mut names: Vec<&str> = file.names().into_iter().filter_map(|n| n.strip_suffix("/points")).collect();
    names.sort_unstable();
    names
        .into_iter()
        .map(|name| {
            let flat: Vec<f32> = floats(&format!("{name}/points"))?.collect();
            Ok(GoldenSet {
                name: name.to_owned(),
                points: flat.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect(),
                idx: words(&format!("{name}/idx"))?.into_iter().map(i32::from_le_bytes).collect(),
                d2: floats(&format!("{name}/d2"))?.collect(),
                tie: file.tensor(&format!("{name}/tie"))?.data().to_vec(),
            })
        })
        .collect()
}

impl GoldenSet {
    pub(crate) fn check(&self, found: &Neighbors) -> Report {
        let n = self.points.len();
        let mut report = Report {
            wrong_k: (found.rows, found.k) != (n, K.min(n - 1)),
            wrong_indices: 0,
            compared_indices: 0,
            ties: 0,
            worst_distance: 0.0,
        };
        for row in 0..found.rows.min(n) {
            let (indices, sq_distances) = found.row(row);
            for (j, (&index, &sq_distance)) in indices.iter().zip(sq_distances).enumerate().take(K) {
                let at = row * K + j;
                let (golden, ours) = (f64::from(self.d2[at]), f64::from(sq_distance));
                let deviation = (ours - golden).abs() / golden.max(f64::MIN_POSITIVE);
                report.worst_distance = report.worst_distance.max(deviation);
                if self.tie[at] == 1 {
                    report.ties += 1;
                } else {
                    report.compared_indices += 1;
                    report.wrong_indices += usize::from(i64::from(self.idx[at]) != i64::from(index));
                }
            }
        }
        report
    }
}

impl Report {
    /// Three roundings to f32 and the stored f32 are within 4 × 2^-24; ties may also swap within 1e-6.
    pub(crate) fn passed(&self) -> bool {
        !self.wrong_k && self.compared_indices > 0 && self.wrong_indices == 0 && self.worst_distance < 1.5e-6
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(
            f,
            "{} of {} untied indices differ, {} ties, squared distances within {:.1e} relative",
            self.wrong_indices, self.compared_indices, self.ties, self.worst_distance
        )?;
        if self.wrong_k { f.write_str(", wrong shape") } else { Ok(()) }
    }
}
