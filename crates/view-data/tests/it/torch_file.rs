//! Writes files of `torch.save`, whole ones and broken ones, without PyTorch.

use std::io::Write;
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// A pickle under construction, and the storages that it refers to.
#[derive(Clone, Default)]
pub(crate) struct Saved {
    pub(crate) pickle: Vec<u8>,
    pub(crate) storages: Vec<Vec<u8>>,
}

/// The elements of a tensor.
pub(crate) enum Elements<'a> {
    U8(&'a [u8]),
    I64(&'a [i64]),
    F32(&'a [f32]),
    F64(&'a [f64]),
}

impl Elements<'_> {
    fn name(&self) -> &'static str {
        match self {
            Self::U8(_) => "ByteStorage",
            Self::I64(_) => "LongStorage",
            Self::F32(_) => "FloatStorage",
            Self::F64(_) => "DoubleStorage",
        }
    }

    fn bytes(&self) -> Vec<u8> {
        match self {
            Self::U8(values) => values.to_vec(),
            Self::I64(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            Self::F32(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            Self::F64(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        }
    }

    fn count(&self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::I64(values) => values.len(),
            Self::F32(values) => values.len(),
            Self::F64(values) => values.len(),
        }
    }
}

impl Saved {
    pub(crate) fn new() -> Self {
        Self { pickle: vec![0x80, 2], storages: Vec::new() }
    }

    pub(crate) fn op(&mut self, bytes: &[u8]) -> &mut Self {
        self.pickle.extend_from_slice(bytes);
        self
    }

    pub(crate) fn text(&mut self, text: &str) -> &mut Self {
        let length = u32::try_from(text.len()).unwrap();
        self.op(b"X").op(&length.to_le_bytes()).op(text.as_bytes())
    }

    /// A whole number of any size, as LONG1.
    pub(crate) fn int(&mut self, number: i64) -> &mut Self {
        self.op(&[0x8a, 8]).op(&number.to_le_bytes())
    }

    pub(crate) fn ints(&mut self, numbers: &[i64]) -> &mut Self {
        self.op(b"(");
        for &number in numbers {
            self.int(number);
        }
        self.op(b"t")
    }

    /// A storage, by its persistent id.
    pub(crate) fn storage(&mut self, name: &str, bytes: Vec<u8>, elements: i64) -> &mut Self {
        let key = self.storages.len().to_string();
        self.storages.push(bytes);
        self.op(b"(").text("storage").op(b"ctorch\n").op(name.as_bytes()).op(b"\n");
        self.text(&key).text("cpu").int(elements).op(b"tQ")
    }

    /// What follows the storage in a tensor: offset, shape and strides, and the call.
    pub(crate) fn view(&mut self, offset: i64, shape: &[i64], strides: &[i64]) -> &mut Self {
        self.int(offset).ints(shape).ints(strides);
        self.op(b"\x89ccollections\nOrderedDict\n)RtR")
    }

    pub(crate) fn rebuild(&mut self) -> &mut Self {
        self.op(b"ctorch._utils\n_rebuild_tensor_v2\n(")
    }

    /// A contiguous tensor.
    pub(crate) fn tensor(&mut self, elements: &Elements, shape: &[i64]) -> &mut Self {
        let mut strides = vec![1; shape.len()];
        for axis in (1..shape.len()).rev() {
            strides[axis - 1] = strides[axis] * shape[axis];
        }
        let count = i64::try_from(elements.count()).unwrap();
        self.rebuild().storage(elements.name(), elements.bytes(), count);
        self.view(0, shape, &strides)
    }

    /// Ends the pickle and writes the archive; a name ends in the entry of each storage.
    pub(crate) fn write(&mut self, path: &Path) {
        self.op(b".");
        self.write_as(path, CompressionMethod::Stored, "little");
    }

    pub(crate) fn write_as(&self, path: &Path, method: CompressionMethod, byteorder: &str) {
        let mut zip = ZipWriter::new(std::fs::File::create(path).unwrap());
        let options = SimpleFileOptions::default().compression_method(method);
        let mut entry = |name: &str, bytes: &[u8]| {
            zip.start_file(name, options).unwrap();
            zip.write_all(bytes).unwrap();
        };
        entry("archive/data.pkl", &self.pickle);
        entry("archive/byteorder", byteorder.as_bytes());
        for (key, storage) in self.storages.iter().enumerate() {
            entry(&format!("archive/data/{key}"), storage);
        }
        zip.finish().unwrap();
    }
}

/// A small valid PNG file.
pub(crate) fn png(width: u32, height: u32) -> Vec<u8> {
    let picture = image::RgbImage::from_fn(width, height, |x, y| image::Rgb([x as u8, y as u8, 7]));
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

/// Camera row of a camera at (`x`, 0, 0) that looks along +z.
pub(crate) fn row(x: f32) -> [f32; 18] {
    [0.8, 1.1, 0.5, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, -x, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
}

/// What a scene of a chunk is made of; tests break it.
#[derive(Clone)]
pub(crate) struct Scene {
    pub(crate) key: String,
    pub(crate) timestamps: Vec<i64>,
    pub(crate) rows: Vec<[f32; 18]>,
    pub(crate) images: Vec<Vec<u8>>,
}

impl Scene {
    pub(crate) fn new(key: &str, views: usize) -> Self {
        Self {
            key: key.to_owned(),
            timestamps: (0..views as i64).map(|i| 100 + 7 * i).collect(),
            rows: (0..views).map(|i| row(i as f32)).collect(),
            images: (0..views).map(|_| png(20, 10)).collect(),
        }
    }

    pub(crate) fn save(&self, saved: &mut Saved) {
        saved.op(b"}(").text("key").text(&self.key).text("url").text("https://example.invalid/v");
        let views = self.timestamps.len() as i64;
        saved.text("timestamps").tensor(&Elements::I64(&self.timestamps), &[views]);
        let rows = self.rows.concat();
        saved.text("cameras").tensor(&Elements::F32(&rows), &[self.rows.len() as i64, 18]);
        saved.text("images").op(b"](");
        for image in &self.images {
            saved.tensor(&Elements::U8(image), &[image.len() as i64]);
        }
        saved.op(b"eu");
    }
}

/// Writes a chunk of scenes.
pub(crate) fn write_chunk(path: &Path, scenes: &[Scene]) {
    let mut saved = Saved::new();
    saved.op(b"](");
    for scene in scenes {
        scene.save(&mut saved);
    }
    saved.op(b"e").write(path);
}
