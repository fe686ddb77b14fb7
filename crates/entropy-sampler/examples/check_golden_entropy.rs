//! Checks `entropy` against a file of golden entropies (layout: `fixtures/entropy-sampler/README.md`).
//! `cargo run --release -p entropy-sampler --example check_golden_entropy -- FILE`

#[path = "../tests/it/golden/layout.rs"]
mod layout;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::env::args().nth(1).ok_or("usage: check_golden_entropy FILE")?;
    for picture in layout::read(&std::fs::read(file)?)? {
        for (border, expected) in &picture.expected {
            let worst = picture.worst_deviation(*border, expected)?;
            println!("{:24} {border:8?} within {worst:.1e} bits", picture.name);
            if worst >= layout::TOLERANCE {
                return Err(format!("{} differs", picture.name).into());
            }
        }
    }
    Ok(())
}
