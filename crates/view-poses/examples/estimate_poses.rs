//! Estimates poses without the binary: `estimate_poses INPUT OUTPUT [auto|openmvg|colmap]`. Prints the record.

use std::path::Path;
use view_poses::{EngineChoice, Settings, estimate_poses};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (input, output, engine) = match &arguments[..] {
        [input, output] => (input, output, "auto"),
        [input, output, engine] => (input, output, engine.as_str()),
        _ => return Err("usage: estimate_poses INPUT OUTPUT [auto|openmvg|colmap]".into()),
    };
    let engine = match engine {
        "auto" => EngineChoice::Auto,
        "openmvg" => EngineChoice::OpenMvg,
        "colmap" => EngineChoice::Colmap,
        other => return Err(format!("no engine {other}").into()),
    };
    let settings = Settings { engine, ..Settings::default() };
    let estimate = estimate_poses(Path::new(input), Path::new(output), &settings, &|_| ())?;
    println!("{}", serde_json::to_string_pretty(&estimate)?);
    Ok(())
}
