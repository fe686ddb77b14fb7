//! Checks a data set, prints what was found, and writes the page and the report.
//!
//! `cargo run --release -p check-data --example check_data -- PATH [OUT_DIR]`

use check_data::{CheckSettings, check_data, layout_html};
use std::path::Path;
use std::time::Instant;
use view_data::open;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().ok_or("usage: check_data PATH [OUT_DIR]")?;
    let dataset = open(Path::new(&path), None)?;
    let start = Instant::now();
    let report = check_data(&dataset, &CheckSettings::default(), |_| {})?;
    let seconds = start.elapsed().as_secs_f64();
    let poses = &report.poses;
    println!(
        "{}: {} frames, {} of {} pairs with {} matches, checked in {seconds:.2} s",
        report.name, report.frames, poses.pairs, poses.pairs_tried, poses.matches
    );
    for score in &poses.readings {
        println!(
            "  {:?}: {:.3} / {:.3} px, in front {:.2}",
            score.reading,
            score.median.unwrap_or(f64::NAN),
            score.p90.unwrap_or(f64::NAN),
            score.in_front.unwrap_or(f64::NAN)
        );
    }
    println!("  range {:?}", report.range);
    println!("  depth {:?}", report.depth);
    for finding in &report.findings {
        println!("{:?} [{}] {}: {}", finding.severity, finding.rule, finding.place, finding.text);
    }
    if let Some(folder) = arguments.next() {
        let folder = Path::new(&folder);
        std::fs::create_dir_all(folder)?;
        std::fs::write(folder.join("check.html"), layout_html(&report))?;
        std::fs::write(folder.join("check.json"), serde_json::to_vec_pretty(&report)?)?;
    }
    Ok(())
}
