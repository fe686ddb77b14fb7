//! Where frames come from.

use super::protocol::{self, Broken};
use crate::failure::{Failure, OrFail, Outcome};
use mapper::Frame;
use scene_sim::{Photographs, Traced, generate_dwelling, photograph};
use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};
use view_data::{Dataset, ViewStream};

/// Frames that are decoded ahead.
const AHEAD: usize = 2;
/// How often a source that has nothing is asked again, and a watched folder is listed.
const PATIENCE: Duration = Duration::from_millis(50);
/// The file that ends a watched folder.
const END: &str = "end";
/// Extension of frames in a watched folder.
const EXTENSION: &str = "frame";

/// What comes next.
pub(super) enum Next {
    /// A frame.
    Frame(Box<Frame>),
    /// Something that is no frame; others follow.
    Bad(String),
    /// Nothing yet.
    Nothing,
    /// No more.
    End,
    /// No more, and that is a mistake.
    Broken(String),
}

/// Frames in order.
pub(super) enum Source {
    /// Of a data set.
    Dataset { dataset: Box<Dataset>, positions: Vec<usize>, size: Option<(usize, usize)>, stream: ViewStream },
    /// Of a simulated walk.
    Simulated { traced: Box<Traced>, walk: Photographs, next: usize },
    /// Of a producer, by a thread that reads them.
    Received(Receiver<Next>),
}

impl Source {
    /// The frames of a data set from the frame `skip` on, `most` at most.
    pub(super) fn dataset(
        dataset: Dataset,
        size: Option<(usize, usize)>,
        most: usize,
        skip: usize,
    ) -> Outcome<Self> {
        let mut positions = dataset.present();
        positions.truncate(most);
        let stream = dataset.stream(&positions[skip.min(positions.len())..], size, AHEAD).or_input()?;
        Ok(Self::Dataset { dataset: Box::new(dataset), positions, size, stream })
    }

    /// The walk through a simulated dwelling, from the frame `skip` on.
    pub(super) fn simulated(
        seed: u64,
        size: Option<(usize, usize)>,
        frames: Option<usize>,
        skip: usize,
    ) -> Outcome<Self> {
        let scene = generate_dwelling(seed);
        let traced = Box::new(Traced::new(&scene).or_work()?);
        let mut walk = scene.photographs.ok_or_else(|| Failure::work("the dwelling has no path"))?;
        (walk.width, walk.height) = size.unwrap_or((walk.width, walk.height));
        walk.count = frames.unwrap_or(walk.count);
        Ok(Self::Simulated { traced, walk, next: skip })
    }

    /// Frames of standard input.
    pub(super) fn standard_input() -> Self {
        let (sender, receiver) = sync_channel(AHEAD);
        thread::spawn(move || receive(&sender));
        Self::Received(receiver)
    }

    /// Frames of a folder into which they are put one after the other, from the frame `skip` on; it ends after `idle` without a new one.
    pub(super) fn watched(folder: &Path, idle: Option<Duration>, skip: usize) -> Outcome<Self> {
        if !folder.is_dir() {
            return Err(Failure::input(format!("{}: is no folder that could be watched", folder.display())));
        }
        let (sender, receiver) = sync_channel(AHEAD);
        let folder = folder.to_path_buf();
        thread::spawn(move || watch(&folder, idle, skip, &sender));
        Ok(Self::Received(receiver))
    }

    /// How many frames there are, where that is known.
    pub(super) fn len(&self) -> Option<usize> {
        match self {
            Self::Dataset { positions, .. } => Some(positions.len()),
            Self::Simulated { walk, .. } => Some(walk.count),
            Self::Received(_) => None,
        }
    }

    /// What comes next; waits a little if there is nothing yet.
    pub(super) fn next(&mut self) -> Next {
        match self {
            Self::Dataset { stream, .. } => match stream.next() {
                None => Next::End,
                Some(Ok(view)) => Next::Frame(Box::new(view.into())),
                Some(Err(error)) => Next::Bad(format!("{:#}", anyhow::Error::from(error))),
            },
            Self::Simulated { traced, walk, next } => {
                if *next >= walk.count {
                    return Next::End;
                }
                *next += 1;
                match photograph(traced, walk, *next - 1, 0) {
                    Ok(photograph) => Next::Frame(Box::new(photograph.view.into())),
                    Err(error) => Next::Broken(error.to_string()),
                }
            }
            Self::Received(receiver) => match receiver.recv_timeout(PATIENCE) {
                Ok(next) => next,
                Err(RecvTimeoutError::Timeout) => Next::Nothing,
                Err(RecvTimeoutError::Disconnected) => Next::End,
            },
        }
    }

    /// The frame with this number, read again; none if it was received and is gone.
    pub(super) fn again(&self, frame: usize) -> Outcome<Option<gs_scene::View>> {
        match self {
            Self::Dataset { dataset, positions, size, .. } => {
                Ok(dataset.load_views(&positions[frame..=frame], *size).or_work()?.pop())
            }
            Self::Simulated { traced, walk, .. } => {
                Ok(Some(photograph(traced, walk, frame, 0).or_work()?.view))
            }
            Self::Received(_) => Ok(None),
        }
    }
}

fn decoded(bytes: &[u8], place: &str) -> Next {
    match protocol::decode(bytes) {
        Ok(frame) => Next::Frame(Box::new(frame)),
        Err(fault) => Next::Bad(format!("{place}{:#}", anyhow::Error::from(fault))),
    }
}

/// Reads standard input until it ends, or nobody wants more.
fn receive(sender: &SyncSender<Next>) {
    let mut input = io::BufReader::with_capacity(1 << 16, io::stdin());
    for frame in 0.. {
        let (next, is_last) = match protocol::read(&mut input, frame) {
            Ok(Some(bytes)) => (decoded(&bytes, &format!("standard input, frame {frame}: ")), false),
            Ok(None) => (Next::End, true),
            Err(broken @ Broken::Io(_)) => (Next::Broken(format!("{:#}", anyhow::Error::from(broken))), true),
            Err(broken) => (Next::Broken(broken.to_string()), true),
        };
        if sender.send(next).is_err() || is_last {
            return;
        }
    }
}

/// Reads the frames of a folder in the order of their names as they appear.
fn watch(folder: &Path, idle: Option<Duration>, skip: usize, sender: &SyncSender<Next>) {
    let mut taken: BTreeSet<PathBuf> = BTreeSet::new();
    let mut since = Instant::now();
    loop {
        // What comes with the end file or before it still counts: so it is looked for first.
        let is_over = folder.join(END).exists() || idle.is_some_and(|idle| since.elapsed() > idle);
        let listed = match fs::read_dir(folder) {
            Ok(listed) => listed,
            Err(error) => {
                let _ = sender.send(Next::Broken(format!("{}: cannot list: {error}", folder.display())));
                return;
            }
        };
        let is_new = |path: &PathBuf| {
            path.extension().is_some_and(|extension| extension == EXTENSION) && !taken.contains(path)
        };
        let mut new: Vec<PathBuf> = listed.flatten().map(|entry| entry.path()).filter(is_new).collect();
        new.sort();
        for path in new {
            since = Instant::now();
            let is_skipped = taken.len() < skip;
            let is_late = taken.last().is_some_and(|last| *last > path);
            let next = match (is_late, fs::metadata(&path).map(|found| found.len())) {
                (true, _) => Next::Bad(format!(
                    "{}: comes after a later name: frames are taken in the order of their names",
                    path.display()
                )),
                (_, Ok(length)) if length > protocol::LONGEST as u64 => Next::Bad(format!(
                    "{}: {length} bytes, expected at most {}",
                    path.display(),
                    protocol::LONGEST
                )),
                _ => match fs::read(&path) {
                    Ok(bytes) => decoded(&bytes, &format!("{}: ", path.display())),
                    Err(error) => Next::Bad(format!("{}: cannot read: {error}", path.display())),
                },
            };
            taken.insert(path);
            if !is_skipped && sender.send(next).is_err() {
                return;
            }
        }
        if is_over {
            let _ = sender.send(Next::End);
            return;
        }
        thread::sleep(PATIENCE);
    }
}
