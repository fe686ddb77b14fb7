use crate::{Folder, encoded, files, scene};
use gs_scene::Gaussians;
use proptest::prelude::*;
use splat_formats::Format;

#[test]
fn every_cut_is_an_error() {
    let folder = Folder::new();
    for (format, name, bytes) in files(&scene(1, 2, 11)) {
        // Headers are long: every third cut of those of PLY, every one of the rest.
        for cut in (0..bytes.len()).filter(|cut| cut % 3 == 0 || *cut > 1000 || bytes.len() < 400) {
            // Without a header a whole number of records is a scene.
            if format == Format::Splat && cut > 0 && cut % 32 == 0 {
                assert!(folder.read(&name, &bytes[..cut]).is_ok());
            } else {
                folder.refused(&name, &bytes[..cut]);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn broken_bytes_give_an_error_or_a_valid_scene(
        which in 0usize..5, changes in prop::collection::vec((0.0..1.0f64, any::<u8>()), 1..6),
    ) {
        let (format, name, mut bytes) = files(&scene(2, 4, 5)).swap_remove(which);
        let length = bytes.len() as f64;
        for (share, byte) in changes {
            bytes[(share * length) as usize] = byte;
        }
        if let Ok(read) = Folder::new().read(&name, &bytes) {
            // PLY keeps what is there, NaN as well.
            let finite = |g: &Gaussians| g.geometry().iter().chain(g.sh()).all(|value| value.is_finite());
            prop_assert!(format == Format::Ply || read.format == Format::Ply || finite(&read.gaussians));
        }
    }

    #[test]
    fn any_bytes_behind_the_first_are_survived(which in 0usize..5, body in prop::collection::vec(any::<u8>(), 0..300)) {
        let (_, name, bytes) = files(&scene(0, 1, 5)).swap_remove(which);
        let start = &bytes[..bytes.len().min(20)];
        let _ = Folder::new().read(&name, &[start, &body].concat());
    }
}

#[test]
fn numbers_that_no_gaussian_has_are_refused() {
    let folder = Folder::new();
    let bytes = encoded(&scene(0, 3, 2), Format::Splat);
    let with = |at: usize, value: f32| {
        let mut bytes = bytes.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        folder.refused("x.splat", &bytes)
    };
    assert_eq!(with(32, f32::NAN), ".splat: Gaussian 1: position is NaN, expected a finite number");
    assert_eq!(with(64 + 12, -1.0), ".splat: Gaussian 2: size is -1, expected a finite number of at least 0");
    assert_eq!(with(64 + 16, f32::INFINITY).split(',').next(), Some(".splat: Gaussian 2: size is inf"));
    let mut still = bytes.clone();
    still[28..32].fill(128);
    assert!(folder.refused("x.splat", &still).contains("Gaussian 0: rotation"));
    assert!(folder.refused("x.splat", &bytes[..40]).contains("within Gaussian 1"));
    assert_eq!(folder.refused("x.splat", b""), ".splat: there are no Gaussians, expected at least one");
}

#[test]
fn headers_of_compressed_ply_that_lie() {
    let folder = Folder::new();
    let bytes = encoded(&scene(1, 300, 4), Format::CompressedPly);
    let end = bytes.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
    let (header, body) = (String::from_utf8(bytes[..end].to_vec()).unwrap(), &bytes[end..]);
    let with = |from: &str, to: &str| {
        assert!(header.contains(from), "{from}");
        let header = header.replacen(from, to, 1);
        folder.refused("x.ply", &[header.as_bytes(), body].concat())
    };
    let huge = "element vertex 18446744073709551615";
    assert!(with("element vertex 300", huge).contains("number of chunks is 2"));
    let chunks = "element chunk 72057594037927936";
    let lies = header.replace("element vertex 300", huge).replace("element chunk 2", chunks);
    let message = folder
        .refused("x.ply", &[lies.replace("sh 300", "sh 18446744073709551615").as_bytes(), body].concat());
    assert!(message.contains("truncated: the header promises 72057594037927936 chunks"), "{message}");
    assert!(with("element sh 300", "element sh 299").contains("rows of sh is 299, expected 300"));
    assert!(with("float min_x", "double min_x").contains("element \"chunk\""));
    assert!(with("uint packed_scale", "int packed_scale").contains("element \"vertex\""));
    assert!(with("uchar f_rest_8", "uchar f_rest_9").contains("element \"sh\""));
    assert!(with("property uchar f_rest_8\n", "").contains("element \"sh\""));
    assert!(with("little", "big").contains("is not supported"));
    let mut infinite = bytes.clone();
    infinite[end..end + 4].copy_from_slice(&f32::INFINITY.to_le_bytes());
    assert!(folder.refused("x.ply", &infinite).contains("position is"));
}

#[test]
fn compressed_ply_without_colours_of_chunks_is_read() {
    let folder = Folder::new();
    let header = "ply\nformat binary_little_endian 1.0\nelement chunk 1\n";
    let names = ["min_", "max_", "min_scale_", "max_scale_"]
        .map(|name| ["x", "y", "z"].map(|axis| format!("{name}{axis}")));
    let columns: String = names.iter().flatten().map(|name| format!("property float {name}\n")).collect();
    let packed = ["position", "rotation", "scale", "color"]
        .map(|name| format!("property uint packed_{name}\n"))
        .concat();
    let mut bytes = format!("{header}{columns}element vertex 1\n{packed}end_header\n").into_bytes();
    let bounds = [[-1.0_f32; 3], [3.0; 3], [-5.0; 3], [-4.0; 3]];
    bounds.iter().flatten().for_each(|value| bytes.extend(value.to_le_bytes()));
    // The largest component is w; the middle of the others is 0.
    let rotation = 512_u32 << 20 | 512 << 10 | 512;
    for word in [u32::MAX, rotation, 0, 0xFF00_80FF] {
        bytes.extend(word.to_le_bytes());
    }
    let read = folder.read("x.ply", &bytes).unwrap().gaussians;
    assert_eq!((&read.geometry()[..3], &read.geometry()[7..10]), (&[3.0; 3][..], &[-5.0; 3][..]));
    assert!((read.geometry()[3] - 1.0).abs() < 1e-5 && read.geometry()[4].abs() < 1e-3);
    let rgb = gs_scene::rgb_from_dc([read.sh()[0], read.sh()[1], read.sh()[2]]);
    assert!((rgb[0] - 1.0).abs() < 1e-6 && rgb[1].abs() < 1e-6 && (rgb[2] - 128.0 / 255.0).abs() < 1e-6);
}

#[cfg(unix)]
#[test]
fn a_scene_is_read_from_a_fifo() {
    let folder = Folder::new();
    let path = folder.path("fifo.spz");
    assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
    let scene = scene(1, 50, 3);
    let writer = std::thread::spawn({
        let (path, bytes) = (path.clone(), encoded(&scene, Format::Spz));
        move || std::fs::write(path, bytes).unwrap()
    });
    assert_eq!(splat_formats::read_scene(&path).unwrap().gaussians.len(), 50);
    writer.join().unwrap();
}
