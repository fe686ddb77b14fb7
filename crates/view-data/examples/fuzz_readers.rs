//! Opens mutated files of every layout until the time is over, and says how fast, how much a single allocation took at
//! most, and which case panicked. A case depends on its number alone.
//!
//! `cargo run --release -p view-data --example fuzz_readers -- MINUTES [FIRST_CASE]`; with 0 minutes one case is run.
#![allow(unsafe_code, reason = "an allocator that counts is an unsafe trait; it only calls the system's")]
#![allow(clippy::unwrap_used, reason = "helpers shared with tests unwrap as tests do")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::time::{Duration, Instant};
use view_data::{Format, open_all};

#[path = "../tests/it/samples.rs"]
mod samples;

/// The largest allocation since the last reset, bytes.
static LARGEST: AtomicUsize = AtomicUsize::new(0);

struct Counting;

#[global_allocator]
static COUNTING: Counting = Counting;

// SAFETY: every call goes to the system's allocator with the same arguments; counting touches no memory of theirs.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(memory, layout) }
    }
}

/// More than any single allocation may take, bytes.
const TOO_LARGE: usize = 1 << 30;
/// A case that takes longer hangs, or nearly.
const TOO_LONG: Duration = Duration::from_secs(10);

/// A data set on disk and its files.
struct Sample {
    format: Format,
    root: PathBuf,
    files: Vec<(PathBuf, Vec<u8>)>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let minutes: f64 = arguments.next().ok_or("usage: fuzz_readers MINUTES [FIRST_CASE]")?.parse()?;
    let first: u64 = arguments.next().map_or(Ok(0), |word| word.parse())?;
    let folder = tempfile::tempdir()?;
    let mut all = Vec::new();
    for (i, (format, variant)) in samples::ALL.into_iter().enumerate() {
        let root = samples::write(format, variant, &folder.path().join(i.to_string()));
        let mut files = Vec::new();
        files_below(&root, &mut files)?;
        let scenes = open_all(&root, Some(format))?.scenes;
        for scene in scenes.iter().filter(|scene| !scene.present().is_empty()) {
            scene.load_views(&scene.present()[..1], None)?;
        }
        println!("{format} {variant}: {} files, {} scenes", files.len(), scenes.len());
        all.push(Sample { format, root, files });
    }
    // What a case prints when it panics is told below, with its number.
    std::panic::set_hook(Box::new(|_| {}));
    let (start, length) = (Instant::now(), Duration::from_secs_f64(minutes * 60.0));
    let (mut case, mut opened, mut largest, mut slowest) =
        (first, 0_u64, (0, first), (Duration::ZERO, first));
    let mut failed = Vec::new();
    loop {
        LARGEST.store(0, Relaxed);
        let begin = Instant::now();
        match std::panic::catch_unwind(|| run(&all, case)) {
            Ok(result) => opened += u64::from(result?),
            Err(_) => failed.push((case, "panicked")),
        }
        let (took, taken) = (begin.elapsed(), LARGEST.load(Relaxed));
        largest = largest.max((taken, case));
        slowest = slowest.max((took, case));
        if taken > TOO_LARGE {
            failed.push((case, "allocated more than 1 GiB at once"));
        }
        if took > TOO_LONG {
            failed.push((case, "took more than 10 s"));
        }
        case += 1;
        if start.elapsed() >= length || failed.len() >= 20 {
            break;
        }
    }
    let (cases, seconds) = (case - first, start.elapsed().as_secs_f64());
    println!(
        "{cases} cases in {seconds:.0} s, {:.0} a second; {opened} opened in spite of their mutation",
        cases as f64 / seconds
    );
    println!(
        "largest allocation {} bytes (case {}), slowest {:.3?} (case {})",
        largest.0, largest.1, slowest.0, slowest.1
    );
    for (case, what) in &failed {
        println!("case {case} {what}");
    }
    if failed.is_empty() { Ok(()) } else { Err("a reader failed".into()) }
}

/// Mutates one file, reads the data set, puts the file back. Whether any scene opened.
fn run(all: &[Sample], case: u64) -> std::io::Result<bool> {
    let mut random = Random(case);
    let sample = &all[random.below(all.len())];
    let (path, whole) = &sample.files[random.below(sample.files.len())];
    let mut bytes = whole.clone();
    for _ in 0..=random.below(4) {
        mutate(&mut bytes, &sample.files, &mut random);
    }
    std::fs::write(path, &bytes)?;
    // Put back whatever happens: the next case must not depend on this one.
    let _restore = Restore { path, whole };
    let scenes = open_all(&sample.root, Some(sample.format)).map(|all| all.scenes).unwrap_or_default();
    for scene in &scenes {
        let _ = scene.cameras();
        let _ = scene.points();
        for position in 0..scene.frames.len().min(2) {
            let _ = scene.load_views(&[position], None);
        }
    }
    Ok(!scenes.is_empty())
}

struct Restore<'a> {
    path: &'a Path,
    whole: &'a [u8],
}

impl Drop for Restore<'_> {
    fn drop(&mut self) {
        std::fs::write(self.path, self.whole).expect("the folder is still there");
    }
}

fn mutate(bytes: &mut Vec<u8>, files: &[(PathBuf, Vec<u8>)], random: &mut Random) {
    let at = random.below(bytes.len() + 1);
    match random.below(8) {
        0 => bytes.truncate(at),
        1 => bytes.insert(at, random.next() as u8),
        2 => {
            // A piece of the same or another file.
            let other = &files[random.below(files.len())].1;
            let begin = random.below(other.len() + 1);
            let end = (begin + random.below(64)).min(other.len());
            bytes.splice(at..at, other[begin..end].iter().copied());
        }
        3 => drop(bytes.drain(at..(at + random.below(32)).min(bytes.len()))),
        4 => {
            // Numbers that sit on limits.
            let numbers: [&[u8]; 8] = [
                &[0xff; 8],
                &[0; 8],
                &[0xff, 0xff, 0xff, 0x7f],
                &[0, 0, 0, 0x80],
                b"nan",
                b"-1",
                b"1e999",
                b"9999999999",
            ];
            for (i, byte) in numbers[random.below(8)].iter().enumerate() {
                if let Some(place) = bytes.get_mut(at + i) {
                    *place = *byte;
                }
            }
        }
        _ => {
            if let Some(place) = bytes.get_mut(at) {
                *place =
                    if random.below(2) == 0 { *place ^ (1 << random.below(8)) } else { random.next() as u8 };
            }
        }
    }
}

fn files_below(folder: &Path, found: &mut Vec<(PathBuf, Vec<u8>)>) -> std::io::Result<()> {
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        paths.push(entry?.path());
    }
    paths.sort();
    for path in paths {
        if path.is_dir() {
            files_below(&path, found)?;
        } else {
            let bytes = std::fs::read(&path)?;
            found.push((path, bytes));
        }
    }
    Ok(())
}

/// SplitMix64: numbers that follow from the case's number.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() % limit.max(1) as u64) as usize
    }
}
