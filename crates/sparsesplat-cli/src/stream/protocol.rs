//! Frames as bytes: what a producer writes to standard input, or into files of a watched folder.
//!
//! A frame is one line of JSON (a [`Header`]) that ends with a line feed, then `width * height * 3` bytes RGB, row by row, then, if the header
//! says `"depth": true`, `width * height` z-depths as 32-bit little-endian floats in scene units, 0 where nothing was measured. On standard
//! input each frame stands behind its length in bytes, as a 32-bit little-endian number. A length of 0, or the end of the input between two
//! frames, ends the stream.

use glam::{DMat3, DVec3};
use gs_scene::{Camera, DepthMap, Image, Intrinsics, View};
use mapper::Frame;
use serde::Deserialize;
use std::io::{self, Read};

/// A frame has at most so many bytes: 8192x8192 with depth.
pub(super) const LONGEST: usize = 8192 * 8192 * 7 + LONGEST_HEADER;
/// So many bytes at most come before the picture.
const LONGEST_HEADER: usize = 1 << 16;

/// What the line of JSON says.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    name: String,
    /// Seconds.
    #[serde(default)]
    time: Option<f64>,
    width: usize,
    height: usize,
    fl_x: f64,
    fl_y: f64,
    cx: f64,
    cy: f64,
    /// Rows of rotation and translation, OpenCV axes.
    world_to_camera: [[f64; 4]; 3],
    #[serde(default)]
    depth: bool,
}

/// Why bytes are no frame. The stream goes on after it.
#[derive(Debug, thiserror::Error)]
pub(super) enum Fault {
    #[error("no line of JSON within the first {LONGEST_HEADER} bytes")]
    NoHeader,
    #[error("header {text:?}")]
    Header { text: String, source: serde_json::Error },
    #[error("frame {name}: {found} bytes after the header, expected {expected} for {width}x{height}{with}")]
    Length { name: String, found: usize, expected: usize, width: usize, height: usize, with: &'static str },
    #[error("frame {name}")]
    Scene { name: String, source: gs_scene::Error },
}

/// Why nothing more can be read.
#[derive(Debug, thiserror::Error)]
pub(super) enum Broken {
    #[error("standard input ended within frame {frame}: {found} of {expected} bytes")]
    Ended { frame: usize, found: usize, expected: usize },
    #[error(
        "standard input, frame {frame}: its length is {found} bytes, expected at most {LONGEST}: this is not a stream of frames, or \
         bytes of one are missing"
    )]
    Length { frame: usize, found: usize },
    #[error("standard input: cannot read")]
    Io(#[from] io::Error),
}

/// The start of a header, to be shown.
fn start_of(bytes: &[u8]) -> String {
    const SHOWN: usize = 80;
    String::from_utf8_lossy(&bytes[..bytes.len().min(SHOWN)]).into_owned()
}

/// The frame that bytes hold.
pub(super) fn decode(bytes: &[u8]) -> Result<Frame, Fault> {
    let line = bytes.iter().take(LONGEST_HEADER).position(|byte| *byte == b'\n').ok_or(Fault::NoHeader)?;
    let (header, rest) = (&bytes[..line], &bytes[line + 1..]);
    let header: Header =
        serde_json::from_slice(header).map_err(|source| Fault::Header { text: start_of(header), source })?;
    let Header { name, time, width, height, fl_x, fl_y, cx, cy, world_to_camera, depth } = header;
    let pixels = width.saturating_mul(height);
    let colours = pixels.saturating_mul(3);
    let expected = colours.saturating_add(if depth { pixels.saturating_mul(4) } else { 0 });
    if rest.len() != expected {
        let with = if depth { " with depth" } else { "" };
        return Err(Fault::Length { name, found: rest.len(), expected, width, height, with });
    }
    let make = || -> gs_scene::Result<View> {
        let intrinsics = Intrinsics { fx: fl_x, fy: fl_y, cx, cy, width, height };
        let [a, b, c] = world_to_camera;
        let row = |r: [f64; 4]| DVec3::new(r[0], r[1], r[2]);
        let rotation = DMat3::from_cols(row(a), row(b), row(c)).transpose();
        let camera = Camera::new(intrinsics, rotation, DVec3::new(a[3], b[3], c[3]))?;
        let image = Image::from_rgb8(width, height, &rest[..colours])?;
        let measured: Vec<f32> =
            rest[colours..].as_chunks::<4>().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect();
        let depth = depth.then(|| DepthMap::new(width, height, measured)).transpose()?;
        View::new(name.clone(), image, camera, depth)
    };
    let view = make().map_err(|source| Fault::Scene { name: name.clone(), source })?;
    Ok(Frame { view, time })
}

/// The bytes of the next frame; none at the end. `frame` counts them, for errors.
pub(super) fn read(input: &mut impl Read, frame: usize) -> Result<Option<Vec<u8>>, Broken> {
    let mut length = [0; 4];
    let found = fill(input, &mut length)?;
    match found {
        0 => return Ok(None),
        4 => {}
        _ => return Err(Broken::Ended { frame, found, expected: 4 }),
    }
    let expected = u32::from_le_bytes(length) as usize;
    if expected == 0 {
        return Ok(None);
    }
    if expected > LONGEST {
        return Err(Broken::Length { frame, found: expected });
    }
    // As it comes: a length alone takes no memory.
    let mut bytes = Vec::new();
    let found = input.take(expected as u64).read_to_end(&mut bytes)?;
    if found < expected {
        return Err(Broken::Ended { frame, found, expected });
    }
    Ok(Some(bytes))
}

/// Fills a buffer as far as the input goes.
fn fill(input: &mut impl Read, buffer: &mut [u8]) -> io::Result<usize> {
    let mut found = 0;
    while found < buffer.len() {
        match input.read(&mut buffer[found..]) {
            Ok(0) => break,
            Ok(more) => found += more,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = r#"{"name":"a","time":1.5,"width":2,"height":1,"fl_x":2,"fl_y":2,"cx":1,"cy":0.5,"world_to_camera":[[1,0,0,0],[0,1,0,0],[0,0,1,2]],"depth":true}"#;

    fn frame(header: &str) -> Vec<u8> {
        let mut bytes = header.as_bytes().to_vec();
        bytes.push(b'\n');
        bytes.extend([255, 0, 0, 0, 0, 255]);
        bytes.extend([1.5f32, f32::NAN].iter().flat_map(|v| v.to_le_bytes()));
        bytes
    }

    #[test]
    fn a_frame_comes_as_it_was_sent() {
        let Frame { view, time } = decode(&frame(HEADER)).unwrap();
        assert_eq!((view.name(), time), ("a", Some(1.5)));
        assert_eq!(view.image().data(), [1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        assert_eq!(view.depth().unwrap().data(), [1.5, 0.0]);
        assert_eq!(view.camera().position(), DVec3::new(0.0, 0.0, -2.0));
    }

    #[test]
    fn what_is_no_frame_names_its_rule() {
        let said = |bytes: &[u8]| format!("{:#}", anyhow::Error::from(decode(bytes).unwrap_err()));
        assert!(said(b"").starts_with("no line of JSON"));
        assert!(said(&[7; 1 << 17]).starts_with("no line of JSON"));
        assert!(said(b"garbage\n").starts_with("header \"garbage\": expected value"));
        let whole = frame(HEADER);
        assert_eq!(
            said(&whole[..whole.len() - 1]),
            "frame a: 13 bytes after the header, expected 14 for 2x1 with depth"
        );
        let broken = |from: &str, to: &str| said(&frame(&HEADER.replace(from, to)));
        assert!(broken("\"time\"", "\"tide\"").contains("unknown field"));
        assert!(broken("[0,0,1,2]", "[0,0,1,NaN]").contains("expected value"));
        assert!(broken("[0,0,1,2]", "[0,0,7,2]").contains("frame a: rotation is not orthonormal"));
        assert!(broken("\"fl_x\":2", "\"fl_x\":0").contains("focal length fx is 0"));
        assert!(broken("\"width\":2", "\"width\":18446744073709551615").contains("bytes after the header"));
    }

    #[test]
    fn a_stream_ends_between_frames_or_is_broken() {
        let whole = frame(HEADER);
        let mut stream = (whole.len() as u32).to_le_bytes().to_vec();
        stream.extend(&whole);
        let mut input = &[&stream[..], &stream[..]].concat()[..];
        assert_eq!(read(&mut input, 0).unwrap(), Some(whole.clone()));
        assert_eq!(read(&mut input, 1).unwrap(), Some(whole.clone()));
        assert_eq!(read(&mut input, 2).unwrap(), None);
        assert_eq!(read(&mut &[0u8, 0, 0, 0, 9, 9][..], 0).unwrap(), None);
        let cut = read(&mut &stream[..20], 3).unwrap_err().to_string();
        assert_eq!(cut, format!("standard input ended within frame 3: 16 of {} bytes", whole.len()));
        let cut = read(&mut &stream[..3], 3).unwrap_err().to_string();
        assert_eq!(cut, "standard input ended within frame 3: 3 of 4 bytes");
        let garbage = read(&mut &[0xff_u8; 99][..], 0).unwrap_err().to_string();
        assert!(garbage.contains("its length is 4294967295 bytes"), "{garbage}");
    }
}
