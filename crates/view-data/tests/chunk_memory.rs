//! What a file that means harm may take of memory, counted by an allocator. Its own binary: nothing else may allocate
//! meanwhile. `cargo test -p view-data --test chunk_memory -- --nocapture` prints the figures.
#![allow(unsafe_code, reason = "an allocator that counts is an unsafe trait; it only calls the system's")]
#![allow(clippy::unwrap_used, reason = "helpers of tests unwrap as tests do")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use view_data::open_chunks;

#[allow(dead_code, reason = "one helper of several is used")]
#[path = "it/torch_file.rs"]
mod torch_file;

use torch_file::{Saved, Scene, png};

/// Bytes in use, and the most that were since the last reset.
static IN_USE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

struct Counting;

#[global_allocator]
static COUNTING: Counting = Counting;

// SAFETY: every call goes to the system's allocator with the same arguments; counting touches no memory of theirs.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        PEAK.fetch_max(IN_USE.fetch_add(layout.size(), Relaxed) + layout.size(), Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        IN_USE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(memory, layout) }
    }
}

/// Most bytes taken per byte of the file: a list (24 bytes and its place on the stack, 16, in vectors that double)
/// costs one opcode of one byte.
const PER_BYTE: usize = 120;
/// Buffers and tables that do not depend on the file.
const FIXED: usize = 1 << 20;

/// Opens bytes as a chunk; the most memory that took stays within the bound.
fn check(what: &str, bytes: &[u8]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.torch");
    std::fs::write(&path, bytes).unwrap();
    let before = IN_USE.load(Relaxed);
    PEAK.store(before, Relaxed);
    let dropped = open_chunks(&path).map_or(usize::MAX, |scenes| scenes.dropped.len());
    let peak = PEAK.load(Relaxed) - before;
    println!("{what}: {} bytes, peak {peak}, {:.1} per byte", bytes.len(), peak as f64 / bytes.len() as f64);
    assert!(dropped > 0, "{what} is not sound");
    assert!(peak <= FIXED + PER_BYTE * bytes.len(), "{what}: {peak} bytes for a file of {}", bytes.len());
}

fn file(build: impl FnOnce(&mut Saved)) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.torch");
    let mut saved = Saved::new();
    build(&mut saved);
    saved.write(&path);
    std::fs::read(path).unwrap()
}

/// One test: several would run side by side.
#[test]
fn memory_follows_the_length_of_the_file() {
    for (what, opcodes) in
        [("lists", &b"]"[..]), ("dicts", b"}"), ("memo", b"N\x94"), ("tuples", b"N\x85"), ("marks", b"(")]
    {
        check(what, &file(|saved| _ = saved.op(&opcodes.repeat((1 << 20) / opcodes.len()))));
    }
    check("text of 2^32 bytes", &file(|saved| _ = saved.op(b"X\xff\xff\xff\xff")));
    check("text of 2^64 bytes", &file(|saved| _ = saved.op(b"\x8d\xff\xff\xff\xff\xff\xff\xff\xff")));
    check("memo slot 2^32 - 1", &file(|saved| _ = saved.op(b"Nr\xff\xff\xff\xff")));
    // A tensor of 2^60 elements that repeats one.
    check(
        "cameras",
        &file(|saved| {
            saved.op(b"](").op(b"}(").text("key").text("s").text("cameras").rebuild();
            saved
                .storage("FloatStorage", vec![0; 4], 1)
                .view(0, &[1 << 60, 18], &[0, 0])
                .text("images")
                .op(b"](");
            let bytes = png(8, 8);
            let length = bytes.len() as i64;
            saved.rebuild().storage("ByteStorage", bytes, length).view(0, &[length], &[1]).op(b"eue");
        }),
    );
    // One scene, listed as often as a file may list scenes, and one list of pictures in many scenes.
    check(
        "one scene many times",
        &file(|saved| {
            saved.op(b"](");
            Scene::new("s", 400).save(saved);
            saved.op(b"q\x01").op(&b"h\x01".repeat(1000)).op(b"e");
        }),
    );
    check(
        "one list of pictures in many scenes",
        &file(|saved| {
            saved.op(b"](");
            Scene::new("s", 200).save(saved);
            saved.op(b"0](");
            let bytes = png(20, 10);
            let length = bytes.len() as i64;
            saved.rebuild().storage("ByteStorage", bytes, length).view(0, &[length], &[1]).op(b"q\x07");
            saved.op(&b"h\x07".repeat(400)).op(b"eq\x08").rebuild();
            saved.storage(
                "FloatStorage",
                torch_file::row(0.0).iter().flat_map(|v| v.to_le_bytes()).collect(),
                18,
            );
            saved.view(0, &[401, 18], &[0, 1]).op(b"q\x09");
            for scene in 0..300 {
                saved.op(b"}(").text("key").text(&scene.to_string()).text("images").op(b"h\x08");
                saved.text("cameras").op(b"h\x09u");
            }
            saved.op(b"e");
        }),
    );
    // Directories that promise more entries than there are.
    let sound = file(|saved| {
        saved.op(b"](");
        Scene::new("s", 2).save(saved);
        saved.int(1).op(b"e");
    });
    let end = sound.len() - 22;
    assert_eq!(&sound[end..end + 4], b"PK\x05\x06");
    for (what, at, value) in [("count", 8, [0xfe; 4]), ("length", 12, [0xfe; 4]), ("start", 16, [0xfe; 4])] {
        let mut broken = sound.clone();
        broken[end + at..end + at + 4].copy_from_slice(&value);
        check(&format!("{what} of the directory"), &broken);
    }
    // Whatever single byte of the directory is set to 0xff.
    let start = u32::from_le_bytes(sound[end + 16..end + 20].try_into().unwrap()) as usize;
    for at in (start..sound.len()).step_by(7) {
        let mut broken = sound.clone();
        broken[at] = 0xff;
        check(&format!("byte {at} of the directory"), &broken);
    }
}
