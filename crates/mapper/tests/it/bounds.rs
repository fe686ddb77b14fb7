use crate::{WALK, config, is_keyframe, push_all, stereo};
use mapper::{BYTES, Config, Error, Mapper, Outcome};

#[test]
fn the_cap_holds_at_every_step_in_gaussians_and_in_bytes() {
    for (cap, bytes) in [(700, None), (1, None), (20_000, Some(500 * BYTES + 7))] {
        let mut mapper = Mapper::new(Config { cap, bytes, ..config() }).unwrap();
        let most = cap.min(bytes.map_or(usize::MAX, |bytes| bytes / BYTES));
        let mut merged = 0;
        for view in &*WALK {
            let update = mapper.push(&view.clone().into()).unwrap();
            assert!(update.gaussians <= most && update.bytes <= most * BYTES, "{update:?}");
            assert_eq!((update.gaussians, update.bytes), (mapper.map().len(), mapper.bytes()));
            if let Outcome::Keyframe(keyframe) = update.outcome {
                merged += keyframe.merged + keyframe.evicted;
            }
        }
        assert_eq!(mapper.map().len(), most, "the walk fills the map");
        assert!(merged > 0);
    }
}

#[test]
fn the_way_back_adds_next_to_nothing() {
    let mut mapper = Mapper::new(config()).unwrap();
    let there = push_all(&mut mapper, &WALK[..24]);
    let after_one = mapper.map().len();
    let back = push_all(&mut mapper, &WALK[24..]);
    let keyframes = |updates: &[_]| updates.iter().filter(|update| is_keyframe(update)).count();
    assert!(keyframes(&there) >= 4, "{}", keyframes(&there));
    assert!(keyframes(&back) <= keyframes(&there) / 3, "{} of {}", keyframes(&back), keyframes(&there));
    assert!(mapper.map().len() as f64 <= 1.1 * after_one as f64, "{after_one}, then {}", mapper.map().len());
}

#[test]
fn what_follows_changes_nothing_of_what_was() {
    for config in [config(), stereo()] {
        let mut short = Mapper::new(config).unwrap();
        let mut long = Mapper::new(config).unwrap();
        let first = push_all(&mut short, &WALK[..12]);
        let all = push_all(&mut long, &WALK[..12]);
        let outcomes =
            |updates: &[mapper::Update]| updates.iter().map(|u| u.outcome.clone()).collect::<Vec<_>>();
        assert_eq!(outcomes(&first), outcomes(&all));
        assert_eq!(short.map(), long.map());
    }
}

#[test]
fn threads_make_no_difference() {
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut mapper = Mapper::new(Config { cap: 1_500, refine: 1, ..config() }).unwrap();
            push_all(&mut mapper, &WALK[..10]);
            mapper.map().clone()
        })
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn settings_out_of_range_are_named() {
    let good = config();
    let bad = [
        ("cap", Config { cap: 0, ..good }),
        ("bytes", Config { bytes: Some(BYTES - 1), ..good }),
        ("tau", Config { tau: f64::NAN, ..good }),
        ("tau", Config { tau: 0.0, ..good }),
        ("window", Config { window: 1, ..good }),
        ("kept", Config { kept: good.window - 1, ..good }),
        ("refine", Config { refine: 6, ..good }),
    ];
    for (expected, config) in bad {
        match Mapper::new(config) {
            Err(Error::Setting { name, .. }) => assert_eq!(name, expected),
            other => panic!("{expected}: {other:?}"),
        }
    }
}
