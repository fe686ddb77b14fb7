//! Prints the source of a pass as it is compiled: `cargo run -p gs-shaders --example shader -- project`.

use gs_shaders::PASSES;
use std::process::ExitCode;

fn main() -> ExitCode {
    let name = std::env::args().nth(1).unwrap_or_default();
    match PASSES.into_iter().find(|pass| pass.name == name) {
        Some(pass) => {
            print!("{}", pass.source());
            ExitCode::SUCCESS
        }
        None => {
            let names: Vec<&str> = PASSES.iter().map(|pass| pass.name).collect();
            eprintln!("no pass {name:?}; passes: {}", names.join(" "));
            ExitCode::from(2)
        }
    }
}
