//! A mapper as a file, from which it goes on to the same bits.

use crate::covisibility::{Footprint, POINTS};
use crate::keyframes::{Keyframe, Keyframes};
use crate::map::{Evidence, Map};
use crate::{Config, Error, Mapper, Result};
use gs_raster::Rasterizer;
use gs_scene::{Camera, Gaussians};
use safetensors::tensor::Dtype;
use serde::{Deserialize, Serialize};
use std::path::Path;
use tensor_files::{Kept, KeptFault, KeptTensor, singles, write_kept};

/// What the files are; another number where their layout or what the mapper computes changes.
const KIND: &str = "mapper-2";

/// Numbers of a Gaussian's evidence.
const EVIDENCE: usize = 3;

/// Everything that a mapper needs to go on: settings, map, evidence, keyframes.
#[derive(Debug, Clone)]
pub struct Snapshot {
    header: Header,
    tensors: Vec<KeptTensor>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct Header {
    config: Config,
    frames: usize,
    latest_time: Option<f64>,
    last: [Option<Camera>; 2],
    /// Keyframes so far.
    count: usize,
    footprints: Vec<Camera>,
    kept: Vec<Picture>,
    waiting: Vec<Picture>,
}

/// A keyframe but for its numbers.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Picture {
    name: String,
    camera: Camera,
    has_depth: bool,
}

fn bytes(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    values.into_iter().flat_map(f32::to_le_bytes).collect()
}

impl Mapper {
    /// The state as it is, to be written.
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        let n = self.map.len();
        let gaussians = &self.map.gaussians;
        let evidence = self.map.evidence.iter().flat_map(|e| [e.mass, e.looks, e.weight]);
        let footprints = self.keyframes.footprints.iter().flat_map(|f| f.depths.iter().copied());
        let f32s = |name: &str, shape: Vec<usize>, data| (name.to_owned(), Dtype::F32, shape, data);
        let mut tensors = vec![
            f32s("geometry", vec![n, Gaussians::GEOMETRY], bytes(gaussians.geometry().iter().copied())),
            f32s("sh", vec![n, 3], bytes(gaussians.sh().iter().copied())),
            f32s("evidence", vec![n, EVIDENCE], bytes(evidence)),
            f32s("footprints", vec![self.keyframes.footprints.len(), POINTS], bytes(footprints)),
        ];
        let mut pictures = |what: &str, all: &[Keyframe]| -> Vec<Picture> {
            let mut put = |(i, keyframe): (usize, &Keyframe)| {
                let (width, height) = (keyframe.camera().width(), keyframe.camera().height());
                tensors.push((
                    format!("{what}.{i}.rgb"),
                    Dtype::U8,
                    vec![height, width, 3],
                    keyframe.rgb.clone(),
                ));
                let footprint = bytes(keyframe.footprint.depths.iter().copied());
                tensors.push(f32s(&format!("{what}.{i}.footprint"), vec![POINTS], footprint));
                if let Some(depth) = &keyframe.depth {
                    let depth = bytes(depth.iter().copied());
                    tensors.push(f32s(&format!("{what}.{i}.depth"), vec![height, width], depth));
                }
                let (name, camera) = (keyframe.name.clone(), *keyframe.camera());
                Picture { name, camera, has_depth: keyframe.depth.is_some() }
            };
            all.iter().enumerate().map(&mut put).collect()
        };
        let kept = pictures("kept", &self.keyframes.kept);
        let waiting = pictures("waiting", &self.waiting);
        let header = Header {
            config: self.config,
            frames: self.frames,
            latest_time: self.latest_time,
            last: self.last,
            count: self.keyframes.count,
            footprints: self.keyframes.footprints.iter().map(|footprint| footprint.camera).collect(),
            kept,
            waiting,
        };
        Snapshot { header, tensors }
    }

    /// The mapper that a file holds. It goes on as if it had never stopped.
    ///
    /// # Errors
    /// If the file cannot be read, is no snapshot, or is damaged; if its parts do not fit each other.
    pub fn resume(path: &Path) -> Result<Self> {
        let fault = |source| Error::Snapshot { path: path.to_path_buf(), source };
        let (header, kept): (Header, Kept) = Kept::read(path, KIND).map_err(fault)?;
        header
            .config
            .check()
            .map_err(|error| Error::SnapshotSettings { path: path.to_path_buf(), source: Box::new(error) })?;
        let rows = kept.tensor("geometry", Dtype::F32, 2).map_err(fault)?.map_or(0, |(shape, _)| shape[0]);
        let read = |name: &str, shape: &[usize]| -> Result<Vec<f32>> {
            Ok(singles(kept.expect(name, Dtype::F32, shape).map_err(fault)?))
        };
        let most = header.config.most();
        if rows > most {
            let (path, what) = (path.to_path_buf(), "number of Gaussians");
            return Err(Error::Inconsistent { path, what, found: rows, expected: most });
        }
        // Into buffers that have room for the whole map.
        let mut map = Map::new(most)?;
        let geometry = read("geometry", &[rows, Gaussians::GEOMETRY])?;
        map.gaussians.append(&Gaussians::new(0, geometry, read("sh", &[rows, 3])?)?);
        let evidence = read("evidence", &[rows, EVIDENCE])?;
        map.evidence.extend(
            evidence.as_chunks::<EVIDENCE>().0.iter().map(|&[mass, looks, weight]| Evidence {
                mass,
                looks,
                weight,
            }),
        );
        let depths = read("footprints", &[header.footprints.len(), POINTS])?;
        let footprints = header.footprints.iter().zip(depths.chunks_exact(POINTS));
        let footprints =
            footprints.map(|(&camera, depths)| Footprint { camera, depths: depths.to_vec() }).collect();
        let pictures = |what: &str, all: &[Picture]| -> Result<Vec<Keyframe>> {
            let keyframe = |(i, picture): (usize, &Picture)| {
                let (width, height) = (picture.camera.width(), picture.camera.height());
                let rgb = kept.expect(&format!("{what}.{i}.rgb"), Dtype::U8, &[height, width, 3]);
                let depth = picture.has_depth.then(|| read(&format!("{what}.{i}.depth"), &[height, width]));
                let depths = read(&format!("{what}.{i}.footprint"), &[POINTS])?;
                Ok(Keyframe {
                    name: picture.name.clone(),
                    footprint: Footprint { camera: picture.camera, depths },
                    rgb: rgb.map_err(fault)?.to_vec(),
                    depth: depth.transpose()?,
                })
            };
            all.iter().enumerate().map(keyframe).collect()
        };
        let keyframes = Keyframes { kept: pictures("kept", &header.kept)?, footprints, count: header.count };
        let waiting = pictures("waiting", &header.waiting)?;
        Ok(Self {
            config: header.config,
            map,
            keyframes,
            waiting,
            frames: header.frames,
            latest_time: header.latest_time,
            last: header.last,
            rasterizer: Rasterizer::cpu(),
        })
    }
}

impl Snapshot {
    /// Writes it, whole or not at all: a reader finds the snapshot before or this one. It is flushed to the disk.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let fault = |source: KeptFault| Error::Snapshot { path: path.to_path_buf(), source };
        write_kept(path, KIND, &self.header, &self.tensors).map_err(fault)
    }
}
