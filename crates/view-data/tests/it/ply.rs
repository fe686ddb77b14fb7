//! Points of PLY files: every encoding, and every rule that can be broken.

use crate::folder::{Folder, chain, three_frames};
use glam::DVec3;
use serde_json::json;

#[test]
fn points_of_a_ply_file_are_read_when_asked_for() {
    let (folder, mut file) = (Folder::new(), three_frames());
    file["ply_file_path"] = json!("sparse.ply");
    folder.json(&file);
    let header = |format: &str, count: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment made by hand\nelement vertex {count}\nproperty float x\nproperty float y\n\
             property double z\nproperty uchar red\nproperty uint8 green\nproperty uchar blue\n\
             element face 0\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let write = |bytes: &[u8]| std::fs::write(folder.path("sparse.ply"), bytes).unwrap();
    let points = || folder.open().unwrap().points().map(Option::unwrap).map_err(|error| chain(&error));
    let little =
        [1.5_f32.to_le_bytes().as_slice(), &2.0_f32.to_le_bytes(), &(-3.25_f64).to_le_bytes(), &[10, 20, 30]]
            .concat();
    let big =
        [1.5_f32.to_be_bytes().as_slice(), &2.0_f32.to_be_bytes(), &(-3.25_f64).to_be_bytes(), &[10, 20, 30]]
            .concat();
    for (format, body) in [
        ("ascii", b"1.5 2 -3.25 10 20 30\n".to_vec()),
        ("binary_little_endian", little),
        ("binary_big_endian", big),
    ] {
        let whole = [header(format, "1").as_bytes(), &body].concat();
        write(&whole);
        let found = points().unwrap();
        assert_eq!((found.len(), found[0].position), (1, DVec3::new(1.5, 2.0, -3.25)), "{format}");
        assert_eq!((found[0].colour, found[0].observations.len()), (Some([10, 20, 30]), 0));
        for cut in 0..whole.len() - usize::from(format == "ascii") {
            write(&whole[..cut]);
            // Without its last digit a number is another number.
            assert!(points().is_err() || format == "ascii", "{format} {cut}");
        }
    }
    for (text, expected) in [
        (header("binary_little_endian", "1152921504606846976"), "1152921504606846976 vertices announced"),
        (header("ascii", "-1"), "header line 4 is not understood: \"element vertex -1\""),
        (header("ascii", "1") + "1 2 nan 0 0 0\n", "line 14: position of a point is NaN"),
        (header("ascii", "1") + "1 2 3 0 0 300\n", "line 14: colour is 300"),
        ("plx\n".to_owned(), "not a PLY file"),
        ("ply\nformat text 1.0\n".to_owned(), "format \"text 1.0\" is not supported"),
        (header("ascii", "1").replace("float x", "float u"), "has no property x"),
        (
            header("ascii", "1").replace("property double z", "property list uchar int z"),
            "vertex property \"z\" is a list",
        ),
    ] {
        write(text.as_bytes());
        let message = points().unwrap_err();
        assert!(
            message.contains("sparse.ply: ") && message.contains(expected),
            "{message:?} lacks {expected:?}"
        );
    }
    std::fs::remove_file(folder.path("sparse.ply")).unwrap();
    assert!(points().unwrap_err().contains("sparse.ply: cannot read"));
}
