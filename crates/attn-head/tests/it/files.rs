#[cfg(feature = "candle")]
use crate::case::Case;
#[cfg(feature = "candle")]
use attn_head::plain::{Network, TensorInputs};
use attn_head::{Config, Error, Kind, Layout, SafetensorsFault, WeightFault, Weights};
#[cfg(feature = "candle")]
use candle_core::{DType, Device};
#[cfg(feature = "candle")]
use candle_nn::{VarBuilder, VarMap};
use proptest::prelude::*;
use safetensors::Dtype;
use safetensors::tensor::TensorView;
use std::collections::HashMap;
use std::sync::LazyLock;

const CONFIG: Config = Config { kind: Kind::MaxPool, geometry: 3, image: 2, neighbours: 1 };

static BYTES: LazyLock<Vec<u8>> =
    LazyLock::new(|| Weights::recipe(CONFIG, "file").unwrap().to_bytes().unwrap());

fn header_len(bytes: &[u8]) -> usize {
    8 + u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize
}

#[test]
fn a_file_gives_back_every_bit() {
    let folder = tempfile::tempdir().unwrap();
    for kind in Kind::ALL {
        let mut weights = Weights::initial(Config { kind, ..CONFIG }, 3).unwrap();
        weights.values[..4].copy_from_slice(&[-0.0, 1e-45, f32::MAX, f32::MIN_POSITIVE]);
        for (key, value) in [("features", "g: Meter \"p\""), ("", ""), ("\u{1f}ü", "\0\n")] {
            weights.metadata.insert(key.to_owned(), value.to_owned());
        }
        let path = folder.path().join("new folder/head.safetensors");
        weights.write(&path).unwrap();
        let read = Weights::read(&path).unwrap();
        assert_eq!((&read.config, &read.metadata), (&weights.config, &weights.metadata));
        let bits = |w: &Weights| w.values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&read), bits(&weights));
        assert_eq!(read.to_bytes().unwrap(), std::fs::read(&path).unwrap());
        assert_eq!(std::fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }
}

#[cfg(feature = "candle")]
#[test]
fn a_network_is_made_of_the_tensors_of_a_file() {
    for kind in Kind::ALL {
        let case = Case::new(kind, 5, 3, 4);
        let inputs = TensorInputs::new(&case.config, &case.inputs(), DType::F32, &Device::Cpu).unwrap();
        let values = case.weights().to_tensor(DType::F32, &Device::Cpu).unwrap();
        let outputs = |network: Result<Network, Error>| {
            let out = network.unwrap().forward(&inputs).unwrap();
            out.flatten_all().unwrap().to_vec1::<f32>().unwrap()
        };
        let bytes = case.weights().to_bytes().unwrap();
        let vb = VarBuilder::from_buffered_safetensors(bytes, DType::F32, &Device::Cpu).unwrap();
        let of_file = outputs(Network::load(case.config, &vb));
        assert_eq!(of_file, outputs(Network::new(case.config, &values)), "{kind:?}");
        let error = Network::load(case.config, &vb.pp("phi_h")).unwrap_err().to_string();
        assert!(error.contains("phi_h.phi_g.0.weight"), "{error}");
    }
}

#[cfg(feature = "candle")]
#[test]
fn the_variables_of_a_network_are_the_parameters_of_its_layout() {
    for (kind, neighbours) in Kind::ALL.into_iter().flat_map(|kind| [(kind, 0), (kind, 3)]) {
        let config = Config { kind, neighbours, ..CONFIG };
        let variables = VarMap::new();
        Network::load(config, &VarBuilder::from_varmap(&variables, DType::F32, &Device::Cpu)).unwrap();
        let variables = variables.data().lock().unwrap();
        let mut found: Vec<_> =
            variables.iter().map(|(name, var)| (name.clone(), var.dims().to_vec())).collect();
        let parameters = Layout::new(&config).parameters;
        let mut expected: Vec<_> = parameters.into_iter().map(|p| (p.name, p.shape)).collect();
        found.sort();
        expected.sort();
        assert_eq!(found, expected, "{kind:?}");
    }
}

#[test]
fn unsound_weights_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("head.safetensors");
    let mut weights = Weights::initial(CONFIG, 3).unwrap();
    weights.values[0] = f32::NAN;
    assert!(matches!(weights.write(&path), Err(Error::Weights { .. })));
    assert!(!path.exists());
}

/// All tensors that do not fit are listed, each with its fault.
#[test]
fn every_tensor_that_does_not_fit_is_named() {
    let weights = Weights::recipe(CONFIG, "file").unwrap();
    let mut tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)> = Layout::new(&CONFIG)
        .parameters
        .into_iter()
        .map(|p| {
            let values = &weights.values[p.offset..][..p.len()];
            (p.name, Dtype::F32, p.shape, values.iter().flat_map(|v| v.to_le_bytes()).collect())
        })
        .collect();
    tensors[0].0 = "phi_h.0.weight".to_owned();
    tensors[1].2 = vec![8, 8];
    tensors[2].1 = Dtype::I32;
    tensors[3].3[4..8].copy_from_slice(&f32::INFINITY.to_le_bytes());
    let views = tensors.iter().map(|(name, dtype, shape, data)| {
        (name.as_str(), TensorView::new(*dtype, shape.clone(), data).unwrap())
    });
    let (_, header) = safetensors::SafeTensors::read_metadata(&BYTES).unwrap();
    let bytes = safetensors::serialize(views, header.metadata().clone()).unwrap();
    let error = Weights::from_bytes(&bytes).unwrap_err();
    assert_eq!(
        error.to_string(),
        "the weights do not fit: phi_g.0.weight is missing; phi_g.0.bias has shape [8, 8], expected [64]; \
         phi_g.2.weight holds I32, expected F32; phi_g.2.bias holds a value that is not finite; \
         phi_h.0.weight is unexpected"
    );
    let Error::Weights { problems } = error else { panic!("another error") };
    assert_eq!(problems[0].fault, WeightFault::Missing);
}

/// A file of no tensors with this under `attn-head`.
fn described(description: Option<&str>) -> Result<Weights, Error> {
    let metadata = description.map(|text| HashMap::from([("attn-head".to_owned(), text.to_owned())]));
    let none: [(&str, TensorView<'_>); 0] = [];
    Weights::from_bytes(&safetensors::serialize(none, metadata).unwrap())
}

#[test]
fn files_tell_whether_they_are_of_this_kind() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    let is = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        Weights::are_in(&path).unwrap()
    };
    // What is wrong with the rest, reading tells.
    assert!(is(&BYTES) && is(&BYTES[..header_len(&BYTES)]));
    let none: [(&str, TensorView<'_>); 0] = [];
    let other = safetensors::serialize(none, Some(HashMap::from([("other".to_owned(), String::new())]))).ok();
    for bytes in [&other.unwrap()[..], b"", b"PK", b"PK\x03\x04 and so on", &[0xff; 64], &BYTES[..20]] {
        assert!(!is(bytes));
    }
    assert!(matches!(Weights::are_in(folder.path().join("nowhere")), Err(Error::File { .. })));
}

#[test]
fn other_files_are_refused() {
    assert!(matches!(described(None), Err(Error::NotAHead { key: "attn-head" })));
    let huge =
        r#"{"config":{"kind":"mlp","geometry":9,"image":64,"neighbours":1000000000000000000},"metadata":{}}"#;
    assert!(matches!(described(Some(huge)), Err(Error::Setting { setting: "neighbours", .. })));
    for text in ["", "{}", &huge.replace("mlp", "MLP"), &huge.replace("image", "images")] {
        let error = described(Some(text)).unwrap_err();
        assert!(matches!(error, Error::Description(_)), "{text}: {error}");
    }
    let whole = described(Some(&huge.replace("1000000000000000000", "1"))).unwrap_err();
    let Error::Weights { problems } = whole else { panic!("another error") };
    assert_eq!(problems.len(), Layout::new(&Config { kind: Kind::Mlp, ..CONFIG }).parameters.len());

    let path = tempfile::tempdir().unwrap().path().join("gone.safetensors");
    let error = Weights::read(&path).unwrap_err();
    assert!(error.to_string().ends_with("gone.safetensors"), "{error}");
    assert!(matches!(error, Error::File { source, .. } if matches!(*source, Error::Io(_))));
}

/// Sizes whose sum overflows a machine word.
#[test]
fn data_that_no_file_could_hold_are_refused() {
    let length = (1_u64 << 61) - 1;
    let tensors: Vec<String> = (0..8)
        .map(|i| {
            let (start, end) = (i * length, (i + 1) * length);
            format!(r#""t{i}":{{"dtype":"U8","shape":[{length}],"data_offsets":[{start},{end}]}}"#)
        })
        .collect();
    let header = format!("{{{}}}", tensors.join(","));
    let bytes = [&(header.len() as u64).to_le_bytes(), header.as_bytes()].concat();
    let truncated = Weights::from_bytes(&bytes);
    assert!(matches!(truncated, Err(Error::NotSafetensors(SafetensorsFault::Truncated { found: 0, .. }))));
    let bytes = [&u64::MAX.to_le_bytes(), header.as_bytes()].concat();
    assert!(matches!(Weights::from_bytes(&bytes), Err(Error::NotSafetensors(_))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_truncated_file_is_an_error(len in 0..BYTES.len()) {
        prop_assert!(Weights::from_bytes(&BYTES[..len]).is_err());
        // And within the header, which is a small part.
        let len = len % header_len(&BYTES);
        prop_assert!(Weights::from_bytes(&BYTES[..len]).is_err());
    }

    /// Damage is refused or gives other weights, which are sound.
    #[test]
    fn a_damaged_file_does_no_harm(places in prop::collection::vec((any::<prop::sample::Index>(), 1..=255_u8), 1..4),
                                   in_header: bool) {
        let mut bytes = BYTES.clone();
        let len = if in_header { header_len(&bytes) } else { bytes.len() };
        for (index, flipped) in places {
            bytes[index.index(len)] ^= flipped;
        }
        if let Ok(weights) = Weights::from_bytes(&bytes) {
            weights.check().unwrap();
        }
    }
}
