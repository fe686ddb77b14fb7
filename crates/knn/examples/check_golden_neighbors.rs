//! Checks `knn` against a file of golden neighbours (layout: `fixtures/knn/README.md`).
//! `cargo run --release -p knn --example check_golden_neighbors -- FILE`

#[path = "../tests/it/golden/layout.rs"]
mod layout;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::env::args().nth(1).ok_or("usage: check_golden_neighbors FILE")?;
    for set in layout::read(&std::fs::read(file)?)? {
        let report = set.check(&knn::knn(&set.points, layout::K)?);
        println!("{:12} {:6} points: {report}", set.name, set.points.len());
        if !report.passed() {
            return Err(format!("{} differs", set.name).into());
        }
    }
    Ok(())
}
