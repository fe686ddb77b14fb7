//! The photographs of a folder: which can be used, how they are turned, and which share a camera.

use crate::error::MINIMUM;
use crate::exif_data::ExifData;
use crate::sharpness::{COMPARED, Look};
use crate::{Error, Result};
use image::codecs::jpeg::JpegEncoder;
use image::metadata::Orientation;
use image::{DynamicImage, ImageEncoder, RgbImage};
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};
use view_data::Dropped;

/// A photograph that can be used, upright.
#[derive(Debug, Clone)]
pub struct Photograph {
    /// File name in the folder of upright photographs.
    pub name: String,
    /// Pixels, upright.
    pub width: usize,
    /// Pixels, upright.
    pub height: usize,
    /// Position in [`Photographs::cameras`].
    pub camera: usize,
    /// Whether it was turned as EXIF says.
    pub turned: bool,
    /// The picture, reduced: colours of points are taken from it.
    #[cfg_attr(not(feature = "openmvg"), allow(dead_code, reason = "COLMAP finds colours itself"))]
    colours: RgbImage,
}

#[cfg(test)]
impl Photograph {
    /// One without a file, of the first camera.
    pub(crate) fn of_size(name: &str, [width, height]: [usize; 2]) -> Self {
        let colours = RgbImage::new(1, 1);
        Self { name: name.to_owned(), width, height, camera: 0, turned: false, colours }
    }
}

impl Photograph {
    /// The colour at a pixel position.
    #[cfg_attr(not(feature = "openmvg"), allow(dead_code, reason = "COLMAP finds colours itself"))]
    pub(crate) fn colour(&self, pixel: glam::DVec2) -> [u8; 3] {
        let (width, height) = self.colours.dimensions();
        let index = |coordinate: f64, length: usize, to: u32| {
            ((coordinate / length as f64 * f64::from(to)) as u32).min(to - 1)
        };
        self.colours.get_pixel(index(pixel.x, self.width, width), index(pixel.y, self.height, height)).0
    }
}

/// Photographs that share one camera and one focal length.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CameraGroup {
    /// Pixels, upright.
    pub width: usize,
    /// Pixels, upright.
    pub height: usize,
    /// EXIF maker and model.
    pub name: Option<String>,
    /// EXIF focal length, millimetres.
    pub focal_mm: Option<f64>,
    /// Focal length by EXIF, pixels.
    pub focal_pixels: Option<f64>,
    /// How many photographs.
    pub photographs: usize,
}

/// The photographs to be posed.
#[derive(Debug, Clone)]
pub struct Photographs {
    /// In the order of their names, which for frames of a video is that of time.
    pub photographs: Vec<Photograph>,
    /// Their cameras.
    pub cameras: Vec<CameraGroup>,
    /// What is not used, and why.
    pub dropped: Vec<Dropped>,
    /// Pictures that were found.
    pub found: usize,
}

/// Most photographs that are taken: every pair is matched, which takes 4 ms of CPU each.
pub const MOST: usize = 400;
/// Mean difference of grey levels up to which two photographs are taken for copies of one.
const SAME: f32 = 0.6;
/// Share of the median sharpness under which a photograph is called blurred.
const BLURRED: f64 = 0.4;
/// Long side of the pictures that colours are taken from, pixels.
const COLOURS: u32 = 160;
/// What photographers call visually lossless.
const JPEG_QUALITY: u8 = 95;

/// Pictures of a folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Listed {
    /// PNG and JPEG files, by name.
    pub files: Vec<PathBuf>,
    /// How many pictures in formats that are not read lie beside them.
    pub other_formats: usize,
}

/// The pictures of a folder, or of its folder `images`.
///
/// # Errors
/// If the folder cannot be listed, or has none.
pub fn list_photographs(folder: &Path) -> Result<Listed> {
    let mut other = 0;
    for folder in [folder.to_path_buf(), folder.join("images")] {
        let entries = match std::fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound && folder.ends_with("images") => break,
            Err(source) => return Err(Error::File { action: "list", path: folder, source }),
        };
        let mut files = Vec::new();
        for entry in entries {
            let path =
                entry.map_err(|source| Error::File { action: "list", path: folder.clone(), source })?.path();
            let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
            let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
            match &*extension {
                _ if hidden || !path.is_file() => {}
                "jpg" | "jpeg" | "png" => files.push(path),
                "heic" | "heif" | "tif" | "tiff" | "dng" | "webp" | "cr2" | "cr3" | "nef" | "arw" | "raf"
                | "orf" | "rw2" | "avif" | "jxl" | "jp2" | "bmp" | "gif" => {
                    other += 1;
                }
                _ => {}
            }
        }
        if !files.is_empty() {
            files.sort();
            return Ok(Listed { files, other_formats: other });
        }
    }
    Err(Error::NoPhotographs { path: folder.to_path_buf(), other })
}

/// A photograph that was read.
struct Read {
    photograph: Photograph,
    exif: ExifData,
    look: Look,
}

/// Reads photographs, writes them upright into the folder `images`, and leaves out what cannot be used: damaged files, and, unless
/// `keep_all`, copies and blurred ones.
///
/// `on_file` is called for every file, from several threads.
///
/// # Errors
/// If a photograph cannot be written, or fewer than two are left.
pub fn prepare_photographs(
    input: &Path,
    files: &[PathBuf],
    images: &Path,
    keep_all: bool,
    on_file: &(dyn Fn(usize, usize) + Sync),
) -> Result<Photographs> {
    if files.len() > MOST {
        return Err(Error::TooMany { path: input.to_path_buf(), found: files.len(), limit: MOST });
    }
    std::fs::create_dir_all(images).map_err(|source| Error::File {
        action: "make the folder",
        path: images.to_path_buf(),
        source,
    })?;
    let done = std::sync::atomic::AtomicUsize::new(0);
    let read: Vec<Result<Read>> = files
        .par_iter()
        .map(|file| {
            let read = read(file, images);
            on_file(done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1, files.len());
            read
        })
        .collect();
    let (mut usable, mut dropped): (Vec<Read>, Vec<Dropped>) = (Vec::new(), Vec::new());
    for (file, read) in files.iter().zip(read) {
        match read {
            Ok(read) => usable.push(read),
            Err(error @ Error::File { .. }) => return Err(error),
            Err(error) => dropped.push(Dropped { key: name_of(file), reason: chain(&error) }),
        }
    }
    if !keep_all {
        drop_copies(&mut usable, &mut dropped);
        drop_blurred(&mut usable, &mut dropped);
    }
    for dropped in &dropped {
        // Damaged files never got there.
        let _ = std::fs::remove_file(images.join(&dropped.key));
    }
    if usable.len() < MINIMUM {
        return Err(Error::TooFew {
            path: input.to_path_buf(),
            found: files.len(),
            usable: usable.len(),
            reasons: dropped.iter().map(|entry| format!("{}: {}", entry.key, entry.reason)).collect(),
        });
    }
    let (photographs, cameras) = grouped(usable);
    Ok(Photographs { photographs, cameras, dropped, found: files.len() })
}

fn read(file: &Path, images: &Path) -> Result<Read> {
    let unreadable = |action| move |source| Error::File { action, path: file.to_path_buf(), source };
    let (mut picture, bytes) = view_data::decode_picture(file)?;
    let exif = ExifData::read(&bytes);
    let orientation = Orientation::from_exif(exif.orientation).unwrap_or(Orientation::NoTransforms);
    let turned = orientation != Orientation::NoTransforms;
    let name = name_of(file);
    let target = images.join(&name);
    if turned {
        picture.apply_orientation(orientation);
        write_picture(&picture, &target)?;
    } else {
        std::fs::write(&target, &bytes).map_err(unreadable("copy"))?;
    }
    let photograph = Photograph {
        name,
        width: picture.width() as usize,
        height: picture.height() as usize,
        camera: 0,
        turned,
        colours: picture.thumbnail(COLOURS, COLOURS).to_rgb8(),
    };
    let compared = if picture.width().max(picture.height()) > COMPARED {
        picture.thumbnail(COMPARED, COMPARED)
    } else {
        picture
    };
    Ok(Read { photograph, exif, look: Look::of(&compared.to_luma8()) })
}

/// Writes a picture in the format of its name.
pub(crate) fn write_picture(picture: &DynamicImage, target: &Path) -> Result<()> {
    let mut bytes = Vec::new();
    let is_png = target.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
    let encoded = if is_png {
        picture.write_to(&mut std::io::Cursor::new(&mut bytes), image::ImageFormat::Png)
    } else {
        let rgb = picture.to_rgb8();
        JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY).write_image(
            rgb.as_raw(),
            rgb.width(),
            rgb.height(),
            image::ExtendedColorType::Rgb8,
        )
    };
    let write = |source| Error::File { action: "write", path: target.to_path_buf(), source };
    encoded.map_err(|error| write(std::io::Error::other(error)))?;
    std::fs::write(target, bytes).map_err(write)
}

/// Copies of an earlier photograph add nothing, and two views from one place mislead.
fn drop_copies(usable: &mut Vec<Read>, dropped: &mut Vec<Dropped>) {
    let mut kept: Vec<Read> = Vec::with_capacity(usable.len());
    for read in usable.drain(..) {
        match kept.iter().find(|other| other.look.difference(&read.look) < SAME) {
            Some(other) => dropped.push(Dropped {
                key: read.photograph.name,
                reason: format!("looks the same as {}", other.photograph.name),
            }),
            None => kept.push(read),
        }
    }
    *usable = kept;
}

fn drop_blurred(usable: &mut Vec<Read>, dropped: &mut Vec<Dropped>) {
    // Of a few photographs each is needed, and the median says little.
    const FEWEST: usize = 5;
    if usable.len() < FEWEST {
        return;
    }
    let mut sorted: Vec<f64> = usable.iter().map(|read| read.look.sharpness).collect();
    sorted.sort_by(f64::total_cmp);
    let median = sorted[sorted.len() / 2];
    usable.retain(|read| {
        let share = read.look.sharpness / median;
        let blurred = share < BLURRED;
        if blurred {
            dropped.push(Dropped {
                key: read.photograph.name.clone(),
                reason: format!("blurred: {:.0} % of the median sharpness", 100.0 * share),
            });
        }
        !blurred
    });
}

/// One camera for photographs of one size, maker, model and focal length.
fn grouped(read: Vec<Read>) -> (Vec<Photograph>, Vec<CameraGroup>) {
    let mut cameras: Vec<CameraGroup> = Vec::new();
    let mut photographs = Vec::with_capacity(read.len());
    for Read { mut photograph, exif, .. } in read {
        let Photograph { width, height, .. } = photograph;
        let name: Vec<&str> = [&exif.make, &exif.model].into_iter().flatten().map(String::as_str).collect();
        let group = CameraGroup {
            width,
            height,
            name: (!name.is_empty()).then(|| name.join(" ")),
            focal_mm: exif.focal.or(exif.focal_35),
            focal_pixels: exif.focal_pixels(width, height),
            photographs: 0,
        };
        photograph.camera = cameras
            .iter()
            .position(|other| CameraGroup { photographs: 0, ..other.clone() } == group)
            .unwrap_or_else(|| {
                cameras.push(group);
                cameras.len() - 1
            });
        cameras[photograph.camera].photographs += 1;
        photographs.push(photograph);
    }
    (photographs, cameras)
}

fn name_of(file: &Path) -> String {
    file.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// An error and its causes in one line.
pub(crate) fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}
