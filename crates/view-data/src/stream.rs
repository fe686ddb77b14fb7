//! Views one after the other, decoded ahead in parallel, with bounded memory.

use crate::load::load;
use crate::picture::check_pixels;
use crate::{Dataset, Frame, Result};
use gs_scene::View;
use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError, channel};
use std::time::Duration;

/// Views in the order asked for; see [`Dataset::stream`].
#[derive(Debug)]
pub struct ViewStream {
    /// Frames whose decoding has not begun, the next one last.
    waiting: Vec<Frame>,
    size: Option<(usize, usize)>,
    /// Begun, in order; at most as many as the window.
    begun: VecDeque<Receiver<Result<View>>>,
}

impl Dataset {
    /// The views at `positions`, in that order, for data sets that do not fit in memory: while one is used, the next
    /// `window` are decoded on rayon's threads, and no more than `window` are kept. Each comes as
    /// [`Dataset::load_views`] would give it, or as its error, which ends nothing: the views after it follow. Without
    /// `size` views may differ in size.
    ///
    /// # Errors
    /// If a position does not exist, or the target size has no or too many pixels.
    pub fn stream(
        &self,
        positions: &[usize],
        size: Option<(usize, usize)>,
        window: usize,
    ) -> Result<ViewStream> {
        if let Some((width, height)) = size {
            check_pixels("target size", width, height)?;
        }
        let waiting = positions.iter().rev().map(|&position| self.frame(position).cloned());
        let waiting = waiting.collect::<Result<Vec<_>>>()?;
        let mut stream = ViewStream { waiting, size, begun: VecDeque::new() };
        // With no window at all nothing would ever begin.
        for _ in 0..window.max(1) {
            stream.begin();
        }
        Ok(stream)
    }
}

impl ViewStream {
    /// Begins the next frame, if there is one.
    fn begin(&mut self) {
        let Some(frame) = self.waiting.pop() else { return };
        let (sender, receiver) = channel();
        let size = self.size;
        // Whoever drops the stream early wants no answer.
        rayon::spawn(move || drop(sender.send(load(&frame, size))));
        self.begun.push_back(receiver);
    }
}

impl Iterator for ViewStream {
    type Item = Result<View>;

    fn next(&mut self) -> Option<Self::Item> {
        let receiver = self.begun.pop_front()?;
        let view = wait(&receiver);
        self.begin();
        Some(view)
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let left = self.begun.len() + self.waiting.len();
        (left, Some(left))
    }
}

impl ExactSizeIterator for ViewStream {}

/// The result of a decoding. A thread of rayon's must not sleep on it: the work may be waiting for this very thread.
fn wait(receiver: &Receiver<Result<View>>) -> Result<View> {
    loop {
        match receiver.try_recv() {
            Ok(view) => return view,
            Err(TryRecvError::Disconnected) => break,
            Err(TryRecvError::Empty) => {}
        }
        let slept = match rayon::yield_now() {
            Some(rayon::Yield::Executed) => continue,
            Some(rayon::Yield::Idle) => receiver.recv_timeout(Duration::from_millis(1)),
            None => receiver.recv().map_err(|_| RecvTimeoutError::Disconnected),
        };
        match slept {
            Ok(view) => return view,
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    unreachable!("decoding sends a result, or its panic ends the process")
}
