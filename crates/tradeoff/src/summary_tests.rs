use super::*;
use crate::journal::tests::{header, label, measured};

/// A sweep of one window and seed: entropy at 1k, 10k, 100k ... with these PSNRs, one Gaussian per pixel with another, 1M.
pub(crate) fn summary(psnrs: &[f64], aligned: f64) -> Summary {
    let mut labels = Vec::new();
    let mut entries = Vec::new();
    for (i, &psnr) in psnrs.iter().enumerate() {
        let n = 1000 * 10usize.pow(i as u32);
        let name = format!("entropy-{}k", n / 1000);
        entries.push(Entry::Measured(measured("a/0", 0, &name, n, psnr)));
        labels.push(Label { count: Some(n), ..label(&name, Axis::Budget, "entropy", i == 0) });
    }
    labels.push(label("pixel-aligned", Axis::Budget, "pixel-aligned", false));
    entries.push(Entry::Measured(measured("a/0", 0, "pixel-aligned", 1_000_000, aligned)));
    Summary::new(&header(&["a/0"], &labels, &[0]), &entries)
}

fn failed(window: &str, point: Option<&str>) -> Entry {
    let point = point.map(str::to_owned);
    Entry::Failed(Failed { window: window.into(), point, seed: 0, reason: "broken".into() })
}

#[test]
fn the_front_the_knee_and_the_share_are_found() {
    let summary = summary(&[20.0, 22.8, 23.0], 22.9);
    let on: Vec<bool> = summary.points.iter().map(|row| row.on_front_of_gaussians).collect();
    assert_eq!(on, [true, true, true, false]);
    let knee = summary.knee_of_gaussians.as_ref().unwrap();
    assert_eq!((knee.point.as_str(), knee.saved), ("entropy-10k", 90_000.0));
    let Reached::At { gaussians } = summary.shares[0].reached else { panic!("{:?}", summary.shares) };
    assert!((gaussians - 1e4 * 10f64.sqrt()).abs() < 1.0);
    assert_eq!(summary.points[0].seconds_to_gaussians, 1.25);
    assert!((summary.points[1].frames_per_second - 1000.0).abs() < 1e-6);
    assert_eq!(summary.failures(), 0);
}

#[test]
fn means_are_over_windows_then_scenes_and_the_spread_over_seeds() {
    let header = header(&["a/0", "a/1", "b/0"], &[label("p", Axis::Budget, "entropy", true)], &[0, 1]);
    let mut entries = Vec::new();
    for (window, psnrs) in [("a/0", [10.0, 12.0]), ("a/1", [20.0, 22.0]), ("b/0", [30.0, 32.0])] {
        for (seed, psnr) in psnrs.into_iter().enumerate() {
            entries.push(Entry::Measured(measured(window, seed as u64, "p", 100, psnr)));
        }
    }
    let summary = Summary::new(&header, &entries);
    let row = &summary.points[0];
    assert_eq!(row.psnr_held_out, (22.5 + 24.5) / 2.0);
    assert!((row.spread.unwrap().psnr_held_out - 2f64.sqrt()).abs() < 1e-12);
    // Whatever the order in which shards bring them.
    entries.reverse();
    assert_eq!(Summary::new(&header, &entries).points[0].psnr_held_out, row.psnr_held_out);
}

#[test]
fn a_window_or_point_that_fails_is_a_row_with_its_reason() {
    let labels = [label("p", Axis::Budget, "entropy", true), label("q", Axis::Sampler, "entropy", false)];
    let header = header(&["a/0", "b/0", "c/0"], &labels, &[0]);
    let entries = [
        failed("a/0", Some("p")),
        Entry::Measured(measured("a/0", 0, "p", 100, 20.0)),
        failed("a/0", Some("q")),
        failed("b/0", None),
        Entry::Measured(measured("c/0", 0, "p", 100, 30.0)),
        Entry::Measured(measured("c/0", 0, "q", 100, 30.0)),
    ];
    let summary = Summary::new(&header, &entries);
    assert_eq!(summary.windows, ["a/0", "c/0"]);
    assert_eq!(summary.points[0].psnr_held_out, 25.0);
    assert_eq!(summary.points[1].failed.as_deref(), Some("a/0: broken"));
    assert!(!summary.points[1].on_front_of_seconds);
    let dropped: Vec<&str> = summary.dropped.iter().map(|dropped| dropped.name.as_str()).collect();
    assert_eq!((dropped, summary.failures()), (vec!["b/0", "q"], 2));
}

#[test]
fn points_with_measured_depth_are_on_no_front() {
    let labels =
        [label("p", Axis::Budget, "entropy", true), label("given-depth", Axis::Backbone, "entropy", false)];
    let entries = [
        Entry::Measured(measured("a/0", 0, "p", 100, 20.0)),
        Entry::Measured(measured("a/0", 0, "given-depth", 10, 40.0)),
    ];
    let summary = Summary::new(&header(&["a/0"], &labels, &[0]), &entries);
    assert!(summary.points[0].on_front_of_gaussians && !summary.points[1].on_front_of_gaussians);
}

#[test]
fn nothing_measured_is_a_summary_of_failures() {
    let header = header(&["a/0"], &[label("p", Axis::Budget, "entropy", true)], &[0]);
    for entries in
        [vec![], vec![failed("a/0", None)], vec![Entry::Measured(measured("a/0", 0, "p", 1, f64::NAN))]]
    {
        let summary = Summary::new(&header, &entries);
        assert!(summary.windows.is_empty() && summary.points[0].failed.is_some());
        assert_eq!(summary.failures(), 1);
    }
}

#[test]
fn heads_have_curves_of_their_own_and_only_the_closed_form_a_share() {
    let mut labels = vec![label("closed-form-pixel-aligned", Axis::Head, "pixel-aligned", false)];
    let mut entries = vec![Entry::Measured(measured("a/0", 0, "closed-form-pixel-aligned", 1_000_000, 21.0))];
    for (head, psnrs) in [("closed-form", [20.0, 22.0]), ("attention", [23.0, 24.0])] {
        for (n, psnr) in [10_000, 40_000].into_iter().zip(psnrs) {
            let name = format!("{head}-{}k", n / 1000);
            labels.push(Label { count: Some(n), ..label(&name, Axis::Head, "entropy", false) });
            entries.push(Entry::Measured(measured("a/0", 0, &name, n, psnr)));
        }
    }
    let summary = Summary::new(&header(&["a/0"], &labels, &[0]), &entries);
    let curves: Vec<(String, usize)> =
        summary.curves().into_iter().map(|(name, rows)| (name, rows.len())).collect();
    assert_eq!(curves, [("entropy, closed form".to_owned(), 2), ("entropy, attention".to_owned(), 2)]);
    let [share] = &summary.shares[..] else { panic!("{:?}", summary.shares) };
    assert_eq!((share.curve.as_str(), share.aligned), ("entropy, closed form", 21.0));
    let Reached::At { gaussians } = share.reached else { panic!("{share:?}") };
    assert!((gaussians - 20_000.0).abs() < 1.0);
}
