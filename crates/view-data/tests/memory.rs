//! Memory of reading, counted by an allocator. Its own binary: nothing else may allocate meanwhile.
#![allow(unsafe_code, reason = "an allocator that counts is an unsafe trait; it only calls the system's")]
#![allow(clippy::unwrap_used, reason = "helpers of tests unwrap as tests do")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use view_data::{Format, open, open_all};

#[allow(dead_code, reason = "some of many are used")]
#[path = "it/samples.rs"]
mod samples;

/// Bytes in use, and the most that were since the last reset.
static IN_USE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

struct Counting;

#[global_allocator]
static COUNTING: Counting = Counting;

fn grown(by: usize) {
    PEAK.fetch_max(IN_USE.fetch_add(by, Relaxed) + by, Relaxed);
}

// SAFETY: every call goes to the system's allocator with the same arguments; counting touches no memory of theirs.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        grown(layout.size());
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        grown(layout.size());
        // SAFETY: as the caller promises.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        IN_USE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(memory, layout) }
    }
}

/// Bytes that `work` takes at most beyond what is in use before.
fn peak<T>(work: impl FnOnce() -> T) -> usize {
    let before = IN_USE.load(Relaxed);
    PEAK.store(before, Relaxed);
    drop(work());
    PEAK.load(Relaxed) - before
}

/// One test: two at once would count each other's.
#[test]
fn streams_keep_a_window_and_files_that_lie_allocate_nothing() {
    a_stream_of_400_frames_takes_no_more_than_its_window();
    files_that_lie_allocate_nothing();
}

fn a_stream_of_400_frames_takes_no_more_than_its_window() {
    const FRAMES: usize = 400;
    let folder = tempfile::tempdir().unwrap();
    samples::picture(&folder.path().join("one.png"), 128, 96);
    let frames = (0..FRAMES).map(|i| {
        std::fs::copy(folder.path().join("one.png"), folder.path().join(format!("{i}.png"))).unwrap();
        format!(
            r#"{{"file_path": "{i}.png", "transform_matrix": [[1,0,0,{i}],[0,-1,0,0],[0,0,-1,0],[0,0,0,1]]}}"#
        )
    });
    let frames = frames.collect::<Vec<_>>().join(",");
    samples::text(
        &folder.path().join("transforms.json"),
        &format!(r#"{{"w": 128, "h": 96, "fl_x": 100, "frames": [{frames}]}}"#),
    );
    let dataset = open(folder.path(), None).unwrap();
    let all: Vec<usize> = (0..FRAMES).collect();
    let view_bytes = 128 * 96 * 3 * 4;
    let stream = |window| {
        let mut count = 0;
        let peak = peak(|| {
            for view in dataset.stream(&all, None, window).unwrap() {
                count += usize::from(view.unwrap().image().width() == 128);
            }
        });
        assert_eq!(count, FRAMES);
        peak
    };
    stream(1);
    for window in [2, 8] {
        let peak = stream(window);
        // A window of views, the one in use, and what decoding takes for each that is under way, which is some views.
        let most = (window * 3 + 4) * view_bytes + 2_000_000;
        assert!(peak < most, "window {window}: {peak} bytes of at most {most}");
        assert!(most < FRAMES * view_bytes / 2, "the bound would not notice");
    }
}

/// Files of a few hundred bytes whose headers announce what would take gigabytes.
fn files_that_lie_allocate_nothing() {
    let most = 64 << 20;
    let check = |name: &str, root: &Path, format: Format| {
        let found = peak(|| {
            for scene in open_all(root, Some(format)).map(|all| all.scenes).unwrap_or_default() {
                let _ = scene.points();
                let _ = scene.load_views(&[0], None);
                let _ = scene.load_views(&[1], None);
            }
        });
        assert!(found < most, "{name}: {found} bytes");
    };
    for name in ["cameras", "images", "points3D"] {
        let folder = tempfile::tempdir().unwrap();
        samples::write(Format::Colmap, "bin", folder.path());
        let path = folder.path().join(format!("sparse/0/{name}.bin"));
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[..8].copy_from_slice(&(1_u64 << 60).to_le_bytes());
        std::fs::write(&path, bytes).unwrap();
        check(name, folder.path(), Format::Colmap);
    }
    type Lie<'a> = (&'a str, &'a dyn Fn(&mut Vec<u8>));
    let lies: [Lie<'_>; 3] = [
        ("points.ply", &|bytes| {
            *bytes = String::from_utf8_lossy(bytes)
                .replace("vertex 2", "vertex 1152921504606846976")
                .replace("ascii", "binary_little_endian")
                .into_bytes();
        }),
        // 30000×30000 pixels; the check sum of the header is not looked at before its size.
        ("depth/0.png", &|bytes| bytes[16..24].copy_from_slice(&[0, 0, 0x75, 0x30, 0, 0, 0x75, 0x30])),
        ("depth/1.exr", &|bytes| {
            let window = bytes.windows(11).position(|w| w == b"dataWindow\0").unwrap() + 21;
            bytes[window + 8..window + 16].copy_from_slice(&[0x0f, 0x27, 0, 0, 0x0f, 0x27, 0, 0]);
        }),
    ];
    for (name, lie) in lies {
        let folder = tempfile::tempdir().unwrap();
        samples::write(Format::Nerfstudio, "", folder.path());
        let path = folder.path().join(name);
        let mut bytes = std::fs::read(&path).unwrap();
        lie(&mut bytes);
        std::fs::write(&path, bytes).unwrap();
        check(name, folder.path(), Format::Nerfstudio);
    }
}
