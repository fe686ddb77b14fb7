//! Twin of the pass `scan`: exclusive prefix sum.

use gs_shaders::Scan;

/// The exclusive prefix sums of the first `scan.n` values, and their total, after `scan_reduce`, `scan_sums` and `scan_apply`.
/// Sums that do not fit are 2³² - 1.
#[must_use]
pub fn scan(scan: &Scan, values: &[u32]) -> (Vec<u32>, u32) {
    let mut total = 0u32;
    let sums = values[..scan.n as usize]
        .iter()
        .map(|&value| {
            let before = total;
            total = total.saturating_add(value);
            before
        })
        .collect();
    (sums, total)
}
