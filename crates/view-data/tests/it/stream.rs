//! Views one after the other.

use crate::folder::{Folder, three_frames};
use view_data::Error;

fn folder() -> Folder {
    let folder = Folder::new();
    folder.json(&three_frames());
    for i in 0..3 {
        folder.picture(&format!("images/{i}.png"), 32, 24);
    }
    folder
}

#[test]
fn a_stream_gives_what_loading_gives_in_order() {
    let folder = folder();
    let dataset = folder.open().unwrap();
    let positions: Vec<usize> = (0..40).map(|i| i * 7 % 3).collect();
    let loaded = dataset.load_views(&positions, Some((20, 12))).unwrap();
    for window in [0, 1, 3, 100] {
        let stream = dataset.stream(&positions, Some((20, 12)), window).unwrap();
        assert_eq!(stream.len(), 40);
        let streamed: Vec<_> = stream.map(Result::unwrap).collect();
        assert_eq!(streamed.len(), loaded.len());
        for (a, b) in streamed.iter().zip(&loaded) {
            assert_eq!((a.name(), a.image().data(), a.camera()), (b.name(), b.image().data(), b.camera()));
        }
    }
}

#[test]
fn a_stream_ends_on_a_pool_of_one_thread_and_when_it_is_dropped_early() {
    let folder = folder();
    let dataset = folder.open().unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    // The consumer holds the only thread that could decode.
    let count =
        pool.install(|| dataset.stream(&[0, 1, 2, 0, 1], None, 2).unwrap().map(Result::unwrap).count());
    assert_eq!(count, 5);
    let mut stream = dataset.stream(&[0, 1, 2], None, 2).unwrap();
    assert_eq!(stream.next().unwrap().unwrap().name(), "0");
    drop(stream);
}

#[test]
fn an_error_takes_the_place_of_its_view_only() {
    let folder = folder();
    let dataset = folder.open().unwrap();
    std::fs::remove_file(folder.path("images/1.png")).unwrap();
    let found: Vec<_> = dataset.stream(&[0, 1, 2], None, 2).unwrap().collect();
    assert!(found[0].is_ok() && found[2].is_ok());
    assert!(matches!(&found[1], Err(Error::MissingPicture { frame, .. }) if frame == "1"));
    assert!(matches!(dataset.stream(&[5], None, 1), Err(Error::Position { position: 5, .. })));
    assert!(matches!(dataset.stream(&[0], Some((0, 1)), 1), Err(Error::TooLarge { .. })));
}
