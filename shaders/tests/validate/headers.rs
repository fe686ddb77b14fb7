//! The comments that open a shader say what it binds, which overrides it reads and where its twin is; and the table of passes
//! has every file.

use gs_shaders::{Access, Features, PASSES, Pass};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

const FOLDER: &str = env!("CARGO_MANIFEST_DIR");
const FEATURES: Features = Features { sh_degree: 0, antialias: false, depth: false };

/// The .wgsl files of a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("the folder of the shaders");
    let files = entries.map(|entry| entry.expect("a folder can be listed").path());
    files.filter(|file| file.extension().is_some_and(|extension| extension == "wgsl")).collect()
}

fn read(file: &Path) -> String {
    fs::read_to_string(file).expect("a shader is text")
}

/// What is wrong with the header of a source that should be that of `pass`.
fn check(pass: &Pass, source: &str) -> Result<(), String> {
    let header: Vec<&str> = source.lines().map_while(|line| line.strip_prefix("//")).collect();
    let field = |name: &str| {
        let lines = header.iter().filter_map(|line| line.trim().strip_prefix(name));
        lines.map(str::trim).next().ok_or(format!("no field {name}"))
    };
    if !header.first().is_some_and(|line| line.starts_with(&format!(" {}: ", pass.name))) {
        return Err("the first line does not begin with the name".to_owned());
    }
    for entry_point in pass.entry_points {
        if !header.iter().any(|line| line.split([' ', ':']).any(|word| word == entry_point.name)) {
            return Err(format!("nothing about {}", entry_point.name));
        }
    }
    if !header.iter().any(|line| line.contains("Dispatch: ")) {
        return Err("no word on the dispatch".to_owned());
    }
    let bindings: Vec<[&str; 3]> = header
        .iter()
        .filter_map(|line| {
            let mut words = line.split_whitespace();
            let number = words.next().filter(|word| word.parse::<u32>().is_ok())?;
            // A word or two about shape and unit follow.
            let row = [number, words.next()?, words.next()?];
            words.next().map(|_| row)
        })
        .collect();
    let numbers: Vec<String> = (0..pass.bindings.len()).map(|number| number.to_string()).collect();
    let expected: Vec<[&str; 3]> = numbers
        .iter()
        .zip(pass.bindings)
        .map(|(number, binding)| {
            let access = match binding.access {
                Access::Uniform => "uniform",
                Access::Read => "read",
                Access::ReadWrite => "read_write",
            };
            [number.as_str(), binding.name, access]
        })
        .collect();
    field("Bindings:")?;
    if bindings != expected {
        return Err(format!("bindings {bindings:?}, expected {expected:?}"));
    }
    let overrides: BTreeSet<&str> = field("Overrides:")?.split(' ').collect();
    let expected: BTreeSet<&str> = pass.constants(FEATURES).into_iter().map(|(name, _)| name).collect();
    if overrides != expected {
        return Err(format!("overrides {overrides:?}, expected {expected:?}"));
    }
    let twin = field("Twin:")?;
    let named_alike = Path::new(twin).file_stem().is_some_and(|stem| stem == pass.name);
    if !(named_alike && Path::new(FOLDER).join("..").join(twin).is_file()) {
        return Err(format!("no twin {twin}"));
    }
    Ok(())
}

#[test]
fn headers_tell_the_truth() {
    for pass in PASSES {
        check(pass, &pass.source()).unwrap_or_else(|error| panic!("{}: {error}", pass.name));
    }
}

#[test]
fn headers_that_lie_are_noticed() {
    let pass = PASSES.into_iter().find(|pass| pass.name == "tile_ranges").expect("a pass");
    for (from, to, expected) in [
        ("// tile_ranges: ", "// ranges: ", "name"),
        ("Dispatch:", "Start:", "dispatch"),
        ("//   1 counters    read  ", "//   1 counters    read_write", "bindings"),
        ("//   2 pair_tiles", "//   3 pair_tiles", "bindings"),
        ("Bindings:", "Buffers:", "Bindings"),
        ("Overrides: WORKGROUP", "Overrides: WORKGROUP TILE", "overrides"),
        ("Twin: crates/gs-reference/src/tile_ranges.rs", "Twin: crates/gs-reference/src/scan.rs", "twin"),
        ("Twin: crates/", "Twin: crate/", "twin"),
    ] {
        let source = pass.source().replacen(from, to, 1);
        assert_ne!(source, pass.source(), "{from} is in the header");
        let error = check(pass, &source).expect_err(to);
        assert!(error.contains(expected), "{to}: {error}");
    }
}

#[test]
fn the_table_has_every_file() {
    let passes = files(Path::new(FOLDER));
    let names: BTreeSet<_> = passes.iter().filter_map(|file| file.file_stem()?.to_str()).collect();
    assert_eq!(names, PASSES.iter().map(|pass| pass.name).collect());
    for pass in PASSES {
        let text = read(&Path::new(FOLDER).join(pass.name).with_extension("wgsl"));
        // Lines of errors are those of the file.
        assert!(pass.source().starts_with(&text), "{} begins with its file", pass.name);
    }
    for file in files(&Path::new(FOLDER).join("common")) {
        let text = read(&file);
        assert!(PASSES.iter().any(|pass| pass.source().contains(&text)), "{} is used", file.display());
    }
}

#[test]
fn shaders_are_plain_wgsl() {
    let folders = [Path::new(FOLDER).to_owned(), Path::new(FOLDER).join("common")];
    for file in folders.iter().flat_map(|folder| files(folder)) {
        for line in read(&file).lines() {
            let words: Vec<&str> = line.split_whitespace().collect();
            let directive = words.first().is_some_and(|word| ["enable", "requires"].contains(word));
            assert!(!line.trim_start().starts_with('#') && !directive, "{}: {line}", file.display());
        }
    }
}
