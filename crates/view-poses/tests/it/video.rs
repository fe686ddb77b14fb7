//! What needs no ffmpeg.

use crate::scenes::Set;
use view_poses::{Settings, estimate_poses, is_video};

#[test]
fn what_is_no_video_is_an_error_that_says_why() {
    let set = Set::new();
    let video = set.beside("clip.mp4");
    let failure = || {
        estimate_poses(&video, &set.beside("scene"), &Settings::default(), &|_| ()).unwrap_err().to_string()
    };
    let not_built = "is not part of this build";
    let missing = failure();
    assert!(missing.contains("clip.mp4: cannot read") || missing.contains(not_built), "{missing}");
    std::fs::write(&video, b"no video at all").unwrap();
    assert!(is_video(&video) && !is_video(&set.photographs()));
    let message = failure();
    // Without ffmpeg the message says how to get it; without an engine, how to build it.
    let expected = ["clip.mp4: no frames can be decoded", "ffmpeg is needed to read a video", not_built];
    assert!(expected.iter().any(|part| message.contains(part)), "{message}");
    assert!(!set.beside("scene").exists());
    let left: Vec<_> =
        std::fs::read_dir(set.beside("")).unwrap().flatten().map(|entry| entry.file_name()).collect();
    assert_eq!(left.len(), 2, "only the video and the folder of photographs are there: {left:?}");
}
