use super::*;
use crate::{DepthBackbone, DepthRange, DepthSplat, Scales, Vit, Wanted};
use glam::{DMat3, DVec3};
use gs_scene::{Camera, Image, Intrinsics, View};
use std::collections::HashMap;
use std::path::PathBuf;
use tempfile::TempDir;

const SMALL: Variant = Variant { scales: Scales::Eighth, vit: Vit::Small };

/// All parameters of the network by the names of the GS checkpoints.
fn weights() -> Vec<(String, Tensor)> {
    let all = DepthSplat::untrained_weights(SMALL, "").unwrap().into_iter();
    all.map(|w| (w.name, Tensor::from_vec(w.values, w.shape, &Device::Cpu).unwrap())).collect()
}

fn views() -> Vec<View> {
    let lens = Intrinsics { fx: 40.0, fy: 40.0, cx: 16.0, cy: 16.0, width: 32, height: 32 };
    let view = |i: usize| {
        let camera = Camera::new(lens, DMat3::IDENTITY, DVec3::new(-0.2 * i as f64, 0.0, 0.0)).unwrap();
        let values = (0..32 * 32 * 3).map(|k| 0.5 + 0.4 * (k as f32 * 0.05 + i as f32).sin()).collect();
        View::new(i.to_string(), Image::new(32, 32, values).unwrap(), camera, None).unwrap()
    };
    (0..2).map(view).collect()
}

fn depth(network: DepthSplat) -> Vec<f32> {
    let network = network.with_range(DepthRange::Known { near: 0.5, far: 100.0 });
    network.estimate(&views(), Wanted::Depth).unwrap()[1].depth.data().to_vec()
}

fn error(path: &Path) -> Error {
    match DepthSplat::open(path) {
        Ok(_) => panic!("{} was opened, expected an error", path.display()),
        Err(error) => error,
    }
}

fn save(folder: &TempDir, name: &str, tensors: Vec<(String, Tensor)>) -> PathBuf {
    let path = folder.path().join(name);
    candle_core::safetensors::save(&tensors.into_iter().collect::<HashMap<_, _>>(), &path).unwrap();
    path
}

#[test]
fn a_whole_checkpoint_is_opened_and_its_name_is_checked() {
    let folder = tempfile::tempdir().unwrap();
    let tensors = weights().into_iter().map(|(name, tensor)| (format!("encoder.{name}"), tensor));
    let path = save(&folder, "gs.safetensors", tensors.collect());
    let network = DepthSplat::open(&path).unwrap();
    assert_eq!((network.variant(), network.has_features()), (SMALL, true));
    assert_eq!(depth(network), depth(DepthSplat::untrained(SMALL, "").unwrap()));

    let wrong = folder.path().join("depthsplat-gs-small-0123abcd.safetensors");
    std::fs::rename(&path, &wrong).unwrap();
    let Error::WeightsHash { expected, found, .. } = error(&wrong) else { panic!("another error") };
    assert_eq!(expected, "0123abcd");
    let right = folder.path().join(format!("depthsplat-gs-small-{found}.safetensors"));
    std::fs::rename(&wrong, &right).unwrap();
    assert!(DepthSplat::open(&right).is_ok());
}

#[test]
fn a_pickle_of_depth_alone_is_opened() {
    let folder = tempfile::tempdir().unwrap();
    let tensors: Vec<_> = weights()
        .into_iter()
        .filter_map(|(name, tensor)| Some((name.strip_prefix(PREDICTOR)?.to_owned(), tensor)))
        .collect();
    let path = folder.path().join("depth.pth");
    std::fs::write(&path, archive(&tensors, Some("model"))).unwrap();
    let network = DepthSplat::open(&path).unwrap();
    assert!(!network.has_features());
    let wanted = network.estimate(&views(), Wanted::DepthAndFeatures);
    assert!(matches!(wanted, Err(Error::NoFeatureWeights)));
    assert_eq!(depth(network), depth(DepthSplat::untrained(SMALL, "").unwrap()));
}

#[test]
fn all_that_does_not_fit_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let norm = "depth_predictor.pretrained.norm.weight";
    let tensors = weights().into_iter().filter_map(|(name, tensor)| {
        let tensor = tensor.to_dtype(DType::F16).unwrap();
        match name.as_str() {
            "depth_predictor.backbone.conv2.bias" => None,
            "gaussian_head.2.bias" => Some(("gaussian_head.3.bias".to_owned(), tensor)),
            "depth_predictor.depth_head.0.2.bias" => Some((name, tensor.narrow(0, 0, 5).unwrap())),
            _ if name == norm => Some((name, (tensor * f64::NAN).unwrap())),
            _ => Some((name, tensor)),
        }
    });
    let path = save(&folder, "faulty.safetensors", tensors.collect());
    let error = error(&path);
    let text = error.to_string();
    let Error::Weights { variant, mut problems, .. } = error else { panic!("{text}") };
    problems.sort_by(|a, b| a.name.cmp(&b.name));
    let problem = |name: &str, fault| WeightProblem { name: name.to_owned(), fault };
    let shape = WeightFault::Shape { expected: vec![128], found: vec![5] };
    assert_eq!(variant, SMALL);
    assert_eq!(
        problems,
        [
            problem("depth_predictor.backbone.conv2.bias", WeightFault::Missing),
            problem("depth_predictor.depth_head.0.2.bias", shape),
            problem(norm, WeightFault::NotFinite),
            problem("gaussian_head.2.bias", WeightFault::Missing),
            problem("gaussian_head.3.bias", WeightFault::Unexpected),
        ]
    );
    assert!(text.contains("faulty.safetensors") && text.contains("has shape [5], expected [128]"), "{text}");
}

/// The tensors that tell the network, and no more.
fn telling() -> Vec<(String, Tensor)> {
    let tells = |name: &str| name.contains("cls_token") || name.contains("concat_projects");
    let ours = weights().into_iter().filter(|(name, _)| name.starts_with(PREDICTOR) && tells(name));
    ours.map(|(name, tensor)| (format!("encoder.{name}"), tensor)).collect()
}

#[test]
fn a_partial_checkpoint_names_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("partial.ckpt");
    std::fs::write(&path, archive(&telling(), Some("state_dict"))).unwrap();
    let error = error(&path);
    assert!(error.to_string().contains("is missing; and"), "{error}");
    let Error::Weights { problems, .. } = error else { panic!("{error}") };
    assert!(problems.iter().all(|problem| problem.fault == WeightFault::Missing));
    assert!(problems.len() > 400);
}

#[test]
fn files_that_are_no_weights() {
    let folder = tempfile::tempdir().unwrap();
    let check = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let error = error(&path);
        assert!(matches!(error, Error::WeightsUnreadable { .. }), "{name}: {error}");
        assert!(error.to_string().contains(name) && std::error::Error::source(&error).is_some());
    };
    check("empty.pth", b"");
    check("text.pth", b"weights, honestly");
    // A header that claims more than there is memory.
    check("huge.safetensors", &[&(1_u64 << 60).to_le_bytes()[..], b"{}"].concat());
    check("other.pth", &zip(&[("archive/version", b"3")]));
    check("nothing.pth", &zip(&[("archive/data.pkl", b"\x80\x02}.")]));
    check("opcode.pth", &zip(&[("archive/data.pkl", b"\x80\x02\xff.")]));
    // Arguments that are not there, at which the reader of pickles stumbles.
    check("arguments.pth", &zip(&[("archive/data.pkl", REBUILD_OF_NOTHING)]));
    let whole = archive(&telling(), None);
    for length in [10, 100, whole.len() / 2, whole.len() - 30] {
        check("truncated.pth", &whole[..length]);
    }
    let mut integers = telling();
    integers[0].1 = integers[0].1.to_dtype(DType::U32).unwrap();
    let path = save(&folder, "integers.safetensors", integers);
    assert!(matches!(error(&path), Error::WeightsUnreadable { .. }));
    let path = folder.path().join("absent.pth");
    assert!(matches!(error(&path), Error::WeightsUnreadable { .. }));
    // Tensors, but of another network.
    let other = vec![("fc.weight".to_owned(), Tensor::zeros(3, DType::F32, &Device::Cpu).unwrap())];
    let path = save(&folder, "other.safetensors", other);
    assert!(matches!(error(&path), Error::WeightsUnknown { found: 1, .. }));
}

const REBUILD_OF_NOTHING: &[u8] = b"\x80\x02}(X\x01\x00\x00\x00actorch._tensor\n_rebuild_from_type_v2\n)Ru.";

/// An archive as `torch.save` writes it.
fn archive(tensors: &[(String, Tensor)], key: Option<&str>) -> Vec<u8> {
    let text = |out: &mut Vec<u8>, text: &str| {
        out.push(b'X');
        out.extend((text.len() as u32).to_le_bytes());
        out.extend(text.as_bytes());
    };
    let int = |out: &mut Vec<u8>, value: usize| {
        out.push(b'J');
        out.extend((value as u32).to_le_bytes());
    };
    let mut pickle = b"\x80\x02}(".to_vec();
    if let Some(key) = key {
        text(&mut pickle, key);
        pickle.extend(b"}(");
    }
    let mut storages = Vec::new();
    for (i, (name, tensor)) in tensors.iter().enumerate() {
        let values: Vec<f32> = tensor.flatten_all().unwrap().to_vec1().unwrap();
        text(&mut pickle, name);
        pickle.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        text(&mut pickle, "storage");
        pickle.extend(b"ctorch\nFloatStorage\n");
        text(&mut pickle, &i.to_string());
        text(&mut pickle, "cpu");
        int(&mut pickle, values.len());
        pickle.extend(b"tQK\x00(");
        tensor.dims().iter().for_each(|&n| int(&mut pickle, n));
        pickle.extend(b"t(");
        tensor.stride().iter().for_each(|&n| int(&mut pickle, n));
        pickle.extend(b"t\x89ccollections\nOrderedDict\n)RtR");
        storages.push((format!("archive/data/{i}"), values.iter().flat_map(|v| v.to_le_bytes()).collect()));
    }
    pickle.extend(if key.is_some() { &b"uu."[..] } else { b"u." });
    let mut files: Vec<(&str, &[u8])> = vec![("archive/data.pkl", &pickle)];
    files.extend(storages.iter().map(|(name, bytes): &(String, Vec<u8>)| (name.as_str(), bytes.as_slice())));
    zip(&files)
}

/// A zip archive without compression.
fn zip(files: &[(&str, &[u8])]) -> Vec<u8> {
    let (mut out, mut directory) = (Vec::new(), Vec::new());
    for (name, bytes) in files {
        let offset = out.len() as u32;
        let mut common = vec![20, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        common.extend(crc(bytes).to_le_bytes());
        common.extend((bytes.len() as u32).to_le_bytes());
        common.extend((bytes.len() as u32).to_le_bytes());
        common.extend((name.len() as u16).to_le_bytes());
        common.extend([0, 0]);
        out.extend(b"PK\x03\x04");
        out.extend(&common);
        out.extend(name.as_bytes());
        out.extend(*bytes);
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&common);
        directory.extend([0; 10]);
        directory.extend(offset.to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let start = out.len() as u32;
    out.extend(&directory);
    out.extend(b"PK\x05\x06\x00\x00\x00\x00");
    out.extend((files.len() as u16).to_le_bytes());
    out.extend((files.len() as u16).to_le_bytes());
    out.extend((directory.len() as u32).to_le_bytes());
    out.extend(start.to_le_bytes());
    out.extend([0, 0]);
    out
}

/// The checksum of zip archives.
fn crc(bytes: &[u8]) -> u32 {
    let table: [u32; 256] = std::array::from_fn(|i| {
        (0..8).fold(i as u32, |c, _| if c & 1 == 1 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 })
    });
    !bytes.iter().fold(!0, |c: u32, b| table[((c ^ u32::from(*b)) & 0xff) as usize] ^ (c >> 8))
}
