//! Files of `torch.save` that mean harm or are damaged: the archive, its pickle, its storages.

use crate::chunk::{Break, fixtures, ledger};
use crate::folder::{Folder, chain};
use crate::torch_file::{Elements, Saved, Scene, png};
use proptest::prelude::*;
use view_data::{Error, TorchRule, open_chunks};
use zip::CompressionMethod;

/// Writes a pickle (what is between the protocol and STOP) as a file; the error that opening it gives.
pub(crate) fn error_of(build: impl FnOnce(&mut Saved)) -> String {
    let folder = Folder::new();
    let path = folder.path("a.torch");
    let mut saved = Saved::new();
    build(&mut saved);
    saved.write(&path);
    chain(&open_chunks(&path).unwrap_err())
}

#[test]
fn every_rule_of_the_container_is_named() {
    let folder = Folder::new();
    let path = folder.path("a.torch");
    let found = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        chain(&open_chunks(&path).unwrap_err())
    };
    assert!(found(b"no archive").contains("not a whole ZIP archive"));
    assert!(found(b"").contains("not a whole ZIP archive"));
    let whole = std::fs::read(fixtures().join("000000.torch")).unwrap();
    assert!(found(&whole[..whole.len() / 2]).contains("not a whole ZIP archive"));

    let mut saved = Saved::new();
    saved.op(b"](").int(1).op(b"e.");
    let error = |saved: &Saved, method, byteorder| {
        saved.write_as(&path, method, byteorder);
        chain(&open_chunks(&path).unwrap_err())
    };
    assert!(error(&saved, CompressionMethod::Stored, "big").contains("byteorder is \"big\""));

    // A flipped byte of the pickle disagrees with its checksum.
    let at = whole.windows(4).position(|window| window == b"aa01").unwrap();
    let mut flipped = whole.clone();
    flipped[at] ^= 1;
    assert!(found(&flipped).contains("data.pkl does not agree with its checksum"));
    // Another compression method in the directory (and nothing else) is no stored entry.
    let mut compressed = whole;
    for at in 0..compressed.len() - 12 {
        if compressed[at..].starts_with(b"PK\x01\x02") {
            compressed[at + 10] = 8;
        }
    }
    let message = found(&compressed);
    assert!(message.contains("is compressed, expected stored bytes"), "{message}");
}

#[test]
fn unknown_functions_are_named_and_not_called() {
    let marker = Folder::new();
    let command = format!("touch {}", marker.path("called").display());
    let named = error_of(|saved| _ = saved.op(b"cos\nsystem\n(").text(&command).op(b"tR"));
    assert!(named.contains("pickle names os system, which is not on the list of what is read"), "{named}");
    let named = error_of(|saved| _ = saved.text("builtins").text("eval").op(b"\x93"));
    assert!(named.contains("pickle names builtins eval"), "{named}");
    assert!(!marker.root().join("called").exists());
}

#[test]
fn every_rule_of_the_pickle_is_named() {
    let tensor = |saved: &mut Saved, elements: i64, shape: &[i64], strides: &[i64]| {
        saved.rebuild().storage("ByteStorage", vec![0; 8], elements).view(0, shape, strides);
    };
    let cases: [(&str, Break<Saved>); 22] = [
        ("pickle protocol 9", Box::new(|saved| _ = saved.op(&[0x80, 9]))),
        ("pickle opcode 0x69", Box::new(|saved| _ = saved.op(b"i"))),
        ("finds too little on the stack", Box::new(|_| ())),
        ("finds too little on the stack", Box::new(|saved| _ = saved.op(b"NR"))),
        ("finds too little on the stack", Box::new(|saved| _ = saved.op(b"e"))),
        // What lies below a MARK is out of reach.
        ("finds too little on the stack", Box::new(|saved| _ = saved.op(b"N(0"))),
        ("finds too little on the stack", Box::new(|saved| _ = saved.op(b"}(Nu"))),
        ("reads memo slot 77", Box::new(|saved| _ = saved.op(b"h\x4d"))),
        ("reads memo slot 4294967295", Box::new(|saved| _ = saved.op(b"j\xff\xff\xff\xff"))),
        ("is not UTF-8", Box::new(|saved| _ = saved.op(b"X\x01\0\0\0\xff"))),
        ("has 9 bytes, expected at most 8", Box::new(|saved| _ = saved.op(b"\x8a\x09123456789"))),
        ("in the middle of its program", Box::new(|saved| _ = saved.op(b"X\xff\xff\xff\xffab"))),
        (
            "in the middle of its program",
            Box::new(|saved| _ = saved.op(b"\x8d\xff\xff\xff\xff\xff\xff\xff\xffab")),
        ),
        ("in the middle of its program", Box::new(|saved| _ = saved.op(b"cwithout end"))),
        ("pickle has int at byte 5, expected list", Box::new(|saved| _ = saved.op(b"K\x01Na"))),
        ("torch.CharStorage, expected ByteStorage", Box::new(|saved| _ = saved.op(b"ctorch\nCharStorage\n"))),
        ("pickle calls OrderedDict", Box::new(|saved| _ = saved.op(b"ccollections\nOrderedDict\nN\x85R"))),
        ("pickle calls _rebuild_tensor_v2", Box::new(|saved| _ = saved.rebuild().op(b"NNNNNNtR"))),
        ("pickle calls a storage", Box::new(|saved| _ = saved.op(b"(NNNNNtQ"))),
        ("has 9 dimensions, expected at most 8", Box::new(move |saved| tensor(saved, 8, &[1; 9], &[1; 9]))),
        ("reaches beyond its storage of 8 elements", Box::new(move |saved| tensor(saved, 8, &[9], &[1]))),
        (
            "reaches beyond its storage of 8 elements",
            Box::new(move |saved| tensor(saved, 8, &[i64::MAX, i64::MAX], &[i64::MAX, i64::MAX])),
        ),
    ];
    for (message, build) in cases {
        let found = error_of(build);
        assert!(found.contains(message), "{found} instead of {message}");
    }
}

#[test]
fn a_storage_that_is_absent_or_of_another_length_is_named() {
    for (elements, stored, message) in
        [(8, 7, "is said to have 8 elements of 4 bytes, but has 28 bytes"), (8, 0, "")]
    {
        let mut saved = Saved::new();
        saved.op(b"](}(").text("key").text("s").text("images").op(b"](");
        let bytes = png(20, 10);
        saved.tensor(&Elements::U8(&bytes), &[bytes.len() as i64]).op(b"e").text("cameras").rebuild();
        saved.storage("FloatStorage", vec![0; stored * 4], elements).view(0, &[1, 18], &[0, 0]).op(b"ue");
        let message = if stored == 0 {
            saved.storages.pop();
            "archive has no entry archive/data/1"
        } else {
            message
        };
        let folder = Folder::new();
        let path = folder.path("a.torch");
        saved.write(&path);
        let ledger = ledger(&open_chunks(&path).unwrap());
        assert!(ledger[0].contains(message), "{ledger:?}");
    }
}

#[test]
fn deep_nesting_and_memo_bombs_end_without_recursion() {
    // A million lists within each other; lists that each hold the one before twice (2^200 items if expanded).
    let folder = Folder::new();
    let path = folder.path("a.torch");
    let mut saved = Saved::new();
    saved.op(&b"](".repeat(1_000_000)).op(&b"e".repeat(1_000_000)).write(&path);
    assert!(ledger(&open_chunks(&path).unwrap())[0].ends_with("the scene is list, expected dict"));
    let mut saved = Saved::new();
    saved.op(b"]q\0");
    for slot in 0..200u8 {
        saved.op(&[b']', b'q', slot + 1, b'(', b'h', slot, b'h', slot, b'e']);
    }
    saved.write(&path);
    assert!(open_chunks(&path).unwrap().scenes.is_empty());
    // A list that holds itself.
    let mut saved = Saved::new();
    saved.op(b"]q\0h\0a").write(&path);
    assert!(open_chunks(&path).unwrap().scenes.is_empty());
    // A pickle beyond the limit is not read.
    let long = error_of(|saved| _ = saved.op(&vec![b'N'; 9 << 20]));
    assert!(long.contains("expected at most 8388608"), "{long}");
}

/// A valid chunk to damage.
fn sound() -> Vec<u8> {
    std::fs::read(fixtures().join("000001.torch")).unwrap()
}

/// Opens bytes as a chunk and loads what opens; whatever they are, this returns.
fn survives(bytes: &[u8]) {
    let folder = Folder::new();
    let path = folder.path("a.torch");
    std::fs::write(&path, bytes).unwrap();
    let Ok(scenes) = open_chunks(&path) else { return };
    for scene in &scenes.scenes {
        for position in 0..scene.frames.len() {
            drop(scene.load_views(&[position], None));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    #[test]
    fn damaged_chunks_never_panic(
        flips in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
        cut in proptest::option::of(any::<prop::sample::Index>()),
        splice in proptest::option::of((any::<prop::sample::Index>(), any::<prop::sample::Index>(), 1usize..64)),
    ) {
        let mut bytes = sound();
        for (at, value) in flips {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some((from, to, length)) = splice {
            let from = from.index(bytes.len() - length);
            let piece = bytes[from..from + length].to_vec();
            let to = to.index(bytes.len());
            bytes.splice(to..to, piece);
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        survives(&bytes);
    }

    /// Programs of the opcodes that are read, with arguments that are mostly short: past the checksum, into the machine.
    #[test]
    fn random_pickles_never_panic(program in proptest::collection::vec(opcode(), 0..60)) {
        let mut saved = Saved::new();
        saved.op(b"](");
        Scene::new("s", 1).save(&mut saved);
        for piece in program {
            saved.op(&piece);
        }
        let folder = Folder::new();
        let path = folder.path("a.torch");
        saved.write(&path);
        survives(&std::fs::read(&path).unwrap());
    }
}

fn opcode() -> impl Strategy<Value = Vec<u8>> {
    let plain = proptest::sample::select(b"(0N1]})ldtaesuRQ2.\x88\x89\x85\x86\x87\x93\x94".to_vec());
    let with_byte = (proptest::sample::select(b"Kqh\x8c\x8a\x80".to_vec()), 0u8..6);
    let storage = "(X\x07\0\0\0storagectorch\nByteStorage\nX\x01\0\0\0";
    let words: Vec<Vec<u8>> = vec![
        b"ctorch._utils\n_rebuild_tensor_v2\n".to_vec(),
        b"ccollections\nOrderedDict\n".to_vec(),
        [storage.as_bytes(), b"0X\x03\0\0\0cpuK\x01tQ"].concat(),
        b"X\x06\0\0\0images".to_vec(),
        b"X\x03\0\0\0key".to_vec(),
        b"X\x07\0\0\0cameras".to_vec(),
        b"e".to_vec(),
        b"u".to_vec(),
    ];
    prop_oneof![
        4 => plain.prop_map(|byte| vec![byte]),
        3 => with_byte.prop_map(|(opcode, value)| vec![opcode, value]),
        3 => proptest::sample::select(words),
        1 => any::<Vec<u8>>().prop_map(|bytes| bytes.into_iter().take(9).collect()),
    ]
}

#[test]
fn rules_of_files_can_be_told_apart() {
    let folder = Folder::new();
    let path = folder.path("a.torch");
    let legacy = std::fs::read(fixtures().join("legacy.pt")).unwrap();
    let rule = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        let Err(Error::Torch { rule, .. }) = open_chunks(&path) else { panic!("a rule") };
        rule
    };
    assert!(matches!(rule(&legacy[..600]), TorchRule::Truncated { .. }));
    assert!(matches!(rule(&legacy[14..]), TorchRule::Archive { .. }));
}
