use crate::{WALK, config, push_all, stereo};
use mapper::{Config, Error, Mapper};
use std::fs;

#[test]
fn a_mapper_goes_on_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.snapshot");
    // Before the first map of stereo, with a full map, and with refinement.
    for (config, at) in
        [(config(), 5), (Config { cap: 900, refine: 1, ..config() }, 9), (stereo(), 2), (stereo(), 12)]
    {
        let mut whole = Mapper::new(config).unwrap();
        push_all(&mut whole, &WALK[..at]);
        whole.snapshot().write(&path).unwrap();
        let mut resumed = Mapper::resume(&path).unwrap();
        assert_eq!(
            (resumed.frames(), resumed.keyframes(), resumed.config()),
            (at, whole.keyframes(), &config)
        );
        let outcomes = |mapper: &mut Mapper| {
            push_all(mapper, &WALK[at..at + 6]).into_iter().map(|update| update.outcome).collect::<Vec<_>>()
        };
        assert_eq!(outcomes(&mut whole), outcomes(&mut resumed));
        let bits = |mapper: &Mapper| -> Vec<u32> {
            let map = mapper.map();
            map.geometry().iter().chain(map.sh()).map(|value| value.to_bits()).collect()
        };
        assert!(bits(&whole) == bits(&resumed), "the map of an uninterrupted run");
    }
}

#[test]
fn a_damaged_snapshot_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("map.snapshot");
    let mut mapper = Mapper::new(Config { cap: 50, ..config() }).unwrap();
    push_all(&mut mapper, &WALK[..2]);
    mapper.snapshot().write(&path).unwrap();
    let whole = fs::read(&path).unwrap();
    let mut garbled = whole.clone();
    garbled[whole.len() - 9] ^= 1;
    for bytes in [&garbled[..], &whole[..whole.len() / 2], b"", b"nonsense that is longer than a header"] {
        fs::write(&path, bytes).unwrap();
        let error = Mapper::resume(&path).unwrap_err();
        assert!(matches!(&error, Error::Snapshot { path: named, .. } if *named == path), "{error}");
    }
    assert!(matches!(Mapper::resume(&folder.path().join("gone")), Err(Error::Snapshot { .. })));
}
