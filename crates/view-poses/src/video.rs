//! Frames of a video, by ffmpeg.

use crate::engine::Step;
use crate::program::{is_there, last_lines};
use crate::sharpness::{COMPARED, detail};
use crate::{Error, Result};
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// How to get ffmpeg.
const INSTALL: &str = "Debian and Ubuntu: apt-get install ffmpeg; macOS: brew install ffmpeg; others: https://ffmpeg.org/download.html";
const PROGRAM: &str = "ffmpeg";

/// Which part of a video is taken, and how many frames of it.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Cut {
    /// Number of frames.
    pub frames: usize,
    /// Seconds from the start of the video.
    pub from: Option<f64>,
    /// Seconds from the start of the video.
    pub to: Option<f64>,
}

impl Default for Cut {
    fn default() -> Self {
        Self { frames: 40, from: None, to: None }
    }
}

/// Extensions of videos.
pub(crate) const VIDEOS: [&str; 10] =
    ["mp4", "mov", "avi", "mkv", "webm", "m4v", "mpg", "mpeg", "3gp", "mts"];

/// Whether a path is that of a video, by its extension.
#[must_use]
pub fn is_video(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    VIDEOS.contains(&&*extension) && !path.is_dir()
}

/// Writes the sharpest frame of each of `cut.frames` stretches of a video into a folder, as JPEG named by their number in the cut. Every frame
/// is looked at. Rotation metadata are applied.
///
/// # Errors
/// If ffmpeg is missing or fails, or the video has no frames there.
pub(crate) fn frames(
    video: &Path,
    cut: Cut,
    folder: &Path,
    on_step: &(dyn Fn(Step) + Sync),
) -> Result<Vec<PathBuf>> {
    if !is_there(PROGRAM) {
        return Err(Error::NoProgram { program: PROGRAM, purpose: "to read a video", install: INSTALL });
    }
    let file = |action, path: &Path| {
        let path = path.to_path_buf();
        move |source| Error::File { action, path, source }
    };
    std::fs::create_dir_all(folder).map_err(file("make the folder", folder))?;
    let log = folder.join("log.txt");
    let said = || last_lines(&std::fs::read_to_string(&log).unwrap_or_default());

    let reduced = format!(
        "scale='if(gt(iw,ih),min(iw,{COMPARED}),-2)':'if(gt(iw,ih),-2,min(ih,{COMPARED}))':flags=area,format=gray"
    );
    let mut reader = command(video, cut, &reduced)
        .args(["-f", "image2pipe", "-c:v", "pgm", "-"])
        .stdout(Stdio::piped())
        .stderr(File::create(&log).map_err(file("write", &log))?)
        .spawn()
        .map_err(file("run", Path::new(PROGRAM)))?;
    let mut details = Vec::new();
    let mut pictures = BufReader::with_capacity(1 << 20, reader.stdout.take().expect("its output is a pipe"));
    let read = loop {
        match next_picture(&mut pictures) {
            Ok(Some((width, height, pixels))) => details.push(detail(&pixels, width, height)),
            Ok(None) => break Ok(()),
            Err(()) => break Err(Error::FrameStream { path: video.to_path_buf() }),
        }
        on_step(Step::Frames(details.len()));
    };
    if read.is_err() {
        // It may still have much to say.
        let _ = reader.kill();
    }
    let status = reader.wait().map_err(file("run", Path::new(PROGRAM)))?;
    if details.is_empty() {
        return Err(Error::NoFrames { path: video.to_path_buf(), said: why_no_frames(&said(), cut) });
    }
    read?;
    if !status.success() {
        return Err(Error::Program {
            program: PROGRAM.to_owned(),
            step: video.display().to_string(),
            status,
            said: said(),
        });
    }

    let chosen = sharpest(&details, cut.frames);
    let select: Vec<String> = chosen.iter().map(|number| format!("eq(n\\,{number})")).collect();
    let status = command(video, cut, &format!("select='{}'", select.join("+")))
        // Twice the quality of what cameras write: the frames are compressed a second time.
        .args(["-c:v", "mjpeg", "-pix_fmt", "yuvj444p", "-q:v", "2", "-start_number", "0"])
        .arg(folder.join("%d.jpg"))
        .stdout(Stdio::null())
        .stderr(File::create(&log).map_err(file("write", &log))?)
        .status()
        .map_err(file("run", Path::new(PROGRAM)))?;
    if !status.success() {
        return Err(Error::Program {
            program: PROGRAM.to_owned(),
            step: video.display().to_string(),
            status,
            said: said(),
        });
    }
    let mut named = Vec::with_capacity(chosen.len());
    for (position, number) in chosen.iter().enumerate() {
        let (from, to) =
            (folder.join(format!("{position}.jpg")), folder.join(format!("frame_{number:06}.jpg")));
        std::fs::rename(&from, &to).map_err(file("find the frame", &from))?;
        named.push(to);
    }
    Ok(named)
}

/// Why a video has no frames, by what ffmpeg says.
fn why_no_frames(said: &str, cut: Cut) -> String {
    if said.contains("matches no streams") {
        return "it has no video stream".to_owned();
    }
    if ["moov atom not found", "Invalid data found", "EBML header parsing failed"]
        .iter()
        .any(|text| said.contains(text))
    {
        return "the file is cut short, damaged, or no video".to_owned();
    }
    match cut.from {
        Some(from) if said.is_empty() => format!("it may be shorter than the {from} s at which to begin"),
        _ => said.to_owned(),
    }
}

fn command(video: &Path, cut: Cut, filter: &str) -> Command {
    let mut command = Command::new(PROGRAM);
    command.args(["-v", "error", "-nostdin", "-y"]);
    if let Some(from) = cut.from {
        command.args(["-ss", &from.to_string()]);
    }
    if let Some(to) = cut.to {
        command.args(["-to", &to.to_string()]);
    }
    // As a file: a name with a colon would be taken for a protocol.
    let mut input = std::ffi::OsString::from("file:");
    input.push(video);
    command.arg("-i").arg(input).args([
        "-map",
        "0:v:0",
        "-an",
        "-sn",
        "-vf",
        filter,
        "-fps_mode",
        "passthrough",
    ]);
    command.stdin(Stdio::null());
    command
}

/// The next picture of a stream of PGM files: width, height, grey levels; None at its end.
fn next_picture(stream: &mut impl Read) -> std::result::Result<Option<(usize, usize, Vec<u8>)>, ()> {
    let mut words: Vec<Vec<u8>> = vec![Vec::new()];
    // A header is magic, width, height and the greatest level, each followed by one white space.
    while words.len() <= 4 {
        let mut byte = [0];
        match stream.read(&mut byte) {
            Ok(0) if words.len() == 1 && words[0].is_empty() => return Ok(None),
            Ok(1) if byte[0].is_ascii_whitespace() => words.push(Vec::new()),
            Ok(1) if words.last().is_some_and(|word| word.len() < 8) => {
                words.last_mut().ok_or(())?.push(byte[0]);
            }
            _ => return Err(()),
        }
    }
    let number = |word: &[u8]| std::str::from_utf8(word).ok()?.parse::<usize>().ok();
    let (width, height) = (number(&words[1]).ok_or(())?, number(&words[2]).ok_or(())?);
    if words[0] != b"P5" || words[3] != b"255" || width == 0 || height == 0 || width.max(height) > 1 << 14 {
        return Err(());
    }
    let mut pixels = vec![0; width * height];
    stream.read_exact(&mut pixels).map_err(|_| ())?;
    Ok(Some((width, height, pixels)))
}

/// The position of the greatest value of each of `count` stretches of a list, or of all where it is short.
fn sharpest(details: &[f64], count: usize) -> Vec<usize> {
    let count = count.min(details.len());
    let stretch = |i: usize| i * details.len() / count..(i + 1) * details.len() / count;
    // The first of equals.
    let best = |range: std::ops::Range<usize>| range.rev().max_by(|&a, &b| details[a].total_cmp(&details[b]));
    (0..count).filter_map(|i| best(stretch(i))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_stretch_gives_its_sharpest_frame() {
        assert_eq!(sharpest(&[1.0, 5.0, 2.0, 2.0, 9.0, 9.0, 0.0], 3), [1, 2, 4]);
        assert_eq!(sharpest(&[1.0, f64::NAN], 5), [0, 1]);
        assert!(sharpest(&[], 5).is_empty());
    }

    #[test]
    fn what_ffmpeg_says_is_translated() {
        let cut = Cut::default();
        assert_eq!(why_no_frames("Stream map '0:v:0' matches no streams.", cut), "it has no video stream");
        assert!(why_no_frames("[mov @ 0x5] moov atom not found", cut).contains("cut short"));
        let late = Cut { from: Some(100.0), ..cut };
        assert_eq!(why_no_frames("", late), "it may be shorter than the 100 s at which to begin");
        assert_eq!(why_no_frames("something else", late), "something else");
    }

    #[test]
    fn pictures_are_read_one_after_the_other() {
        let mut stream = b"P5\n2 1\n255\nab".chain(&b"P5 1 1 255 cP5\n2 2\n255\nab"[..]);
        assert_eq!(next_picture(&mut stream), Ok(Some((2, 1, b"ab".to_vec()))));
        assert_eq!(next_picture(&mut stream), Ok(Some((1, 1, b"c".to_vec()))));
        assert_eq!(next_picture(&mut stream), Err(()));
        for bad in [
            &b"P6\n1 1\n255\na"[..],
            b"P5\n0 1\n255\n",
            b"P5\n1",
            b"P5\nx y\n255\na",
            b"P5\n99999999999 1\n255\na",
        ] {
            assert_eq!(next_picture(&mut &*bad), Err(()), "{bad:?}");
        }
        assert_eq!(next_picture(&mut &b""[..]), Ok(None));
    }
}
