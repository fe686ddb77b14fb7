//! Where work is done: threads and rasterizers of this process.
//!
//! Long work runs on a thread of its own while the caller's waits, so that Ctrl-C ends it early. Work of one piece, which nothing could
//! end, runs on the caller's thread. Neither holds the interpreter's lock: other Python threads run.

use gs_raster::{Device, Rasterizer};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

/// How often a waiting caller looks for signals.
const SIGNALS: Duration = Duration::from_millis(50);
/// Buffers that are kept to be filled anew: fresh memory costs as much time as filling it. A training step has
/// five arrays of gradients; there may be a few steps' at once.
const SPARE: usize = 16;

/// Threads, rasterizers and buffers of one process.
pub(crate) struct Engine {
    process: u32,
    pool: ThreadPool,
    /// One per device; taken out while it works.
    rasterizers: [Mutex<Option<Rasterizer>>; 3],
    spare: Mutex<Vec<Vec<f32>>>,
}

/// The engine of this process. Only looked at while the interpreter is attached: a fork, which Python does in such a moment,
/// never finds it locked.
static ENGINE: Mutex<Option<&'static Engine>> = Mutex::new(None);

/// The engine. After a fork the child gets its own, because threads do not survive one; the parent's is left alone.
///
/// # Errors
/// If the system gives no threads.
pub(crate) fn engine(_: Python<'_>) -> PyResult<&'static Engine> {
    let mut slot = lock(&ENGINE);
    let process = std::process::id();
    if let Some(engine) = slot.filter(|engine| engine.process == process) {
        return Ok(engine);
    }
    let engine = Engine { process, pool: pool()?, rasterizers: Default::default(), spare: Mutex::default() };
    Ok(slot.insert(Box::leak(Box::new(engine))))
}

/// Threads to work on: as many as cores, or as the environment variable `RAYON_NUM_THREADS` says.
///
/// # Errors
/// If the system gives none.
pub(crate) fn pool() -> PyResult<ThreadPool> {
    let pool = ThreadPoolBuilder::new().thread_name(|index| format!("sparsesplat-{index}")).build();
    pool.map_err(|error| PyRuntimeError::new_err(format!("no threads to work on: {error}")))
}

impl Engine {
    /// The process that this engine belongs to.
    pub(crate) fn process(&self) -> u32 {
        self.process
    }

    /// Works on the threads of the engine.
    pub(crate) fn install<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        self.pool.install(work)
    }

    /// Works with the rasterizer of a device, on the threads of the engine. Must not be called from one of these: a thread that
    /// waits for the rasterizer would keep the one that has it from going on.
    pub(crate) fn rasterizer<T: Send>(
        &self,
        device: Device,
        work: impl FnOnce(&mut Rasterizer) -> gs_raster::Result<T> + Send,
    ) -> gs_raster::Result<T> {
        let mut slot = lock(&self.rasterizers[device as usize]);
        // After a panic the slot is empty, and the next call makes a new one.
        let mut rasterizer = slot.take().map_or_else(|| Rasterizer::new(device), Ok)?;
        let result = self.pool.install(|| work(&mut rasterizer));
        *slot = Some(rasterizer);
        result
    }

    /// A spare buffer of this length, filled with anything, or a new one of zeros.
    pub(crate) fn buffer(&self, length: usize) -> Vec<f32> {
        let mut spare = lock(&self.spare);
        let found = spare.iter().position(|buffer| buffer.len() == length);
        if let Some(index) = found {
            return spare.remove(index);
        }
        // Where none fits, the oldest goes: lengths that nobody asks for any more leave in time.
        spare.pop();
        drop(spare);
        vec![0.0; length]
    }

    /// Takes buffers back that nobody needs any more. Not in the child of a fork, which has an engine of its own: the lock of this one may
    /// be held by a thread that the child lacks.
    pub(crate) fn recycle(&self, buffers: impl IntoIterator<Item = Vec<f32>>) {
        if self.process != std::process::id() {
            return;
        }
        let mut spare = lock(&self.spare);
        // The newest come first.
        spare.splice(0..0, buffers);
        spare.truncate(SPARE);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // What is behind these locks is whole at every moment.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The device of a name.
pub(crate) fn device(name: &str) -> PyResult<Device> {
    match name {
        "auto" => Ok(Device::Auto),
        "gpu" => Ok(Device::Gpu),
        "cpu" => Ok(Device::Cpu),
        _ => Err(PyValueError::new_err(format!("device is {name:?}, expected \"auto\", \"gpu\" or \"cpu\""))),
    }
}

/// What work says while it goes on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Progress {
    /// What is being done.
    pub(crate) stage: &'static str,
    /// Share of this stage that is behind, 0 to 1.
    pub(crate) share: f64,
}

/// The way from work to its caller.
pub(crate) struct Caller<'a> {
    gone: Arc<AtomicBool>,
    progress: &'a (dyn Fn(Progress) + Send + Sync),
}

/// What unwinds work whose caller is gone.
struct Gone;

impl Caller<'_> {
    /// Tells how far work is. If the caller is gone, it ends here.
    pub(crate) fn tell(&self, progress: Progress) {
        self.end_if_gone();
        (self.progress)(progress);
    }

    /// Ends work whose caller is gone.
    pub(crate) fn end_if_gone(&self) {
        if self.gone.load(Ordering::Relaxed) {
            resume_unwind(Box::new(Gone));
        }
    }
}

enum Message<T> {
    Progress(Progress),
    Done(thread::Result<T>),
}

/// Does `work` on a thread of its own and waits for it, detached from the interpreter. On Ctrl-C, or if `progress` raises, the
/// exception is returned at once; work ends where it next tells its progress, or runs to its end unheard.
///
/// # Errors
/// What `progress` or a signal handler raises; a `RuntimeError` if there is no thread.
pub(crate) fn run<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Caller) -> T + Send + 'static,
) -> PyResult<T> {
    let (job, ear) = prepare(work);
    named().spawn(job).map_err(|error| no_thread(&error))?;
    ear.listen(py, progress)
}

/// As [`run`], for work that borrows what the caller has: on Ctrl-C the exception is returned when the work has ended. Work of
/// `one_piece` never looks whether its caller is gone; it is done on the caller's thread, which saves the time of a thread.
///
/// # Errors
/// As [`run`].
pub(crate) fn run_borrowing<T: Send>(
    py: Python<'_>,
    one_piece: bool,
    work: impl FnOnce(&Caller) -> T + Send,
) -> PyResult<T> {
    if one_piece {
        let result = py.detach(|| work(&Caller { gone: Arc::default(), progress: &|_| {} }));
        return py.check_signals().map(|()| result);
    }
    thread::scope(|scope| {
        let (job, ear) = prepare(work);
        let thread = named().spawn_scoped(scope, job).map_err(|error| no_thread(&error))?;
        let result = ear.listen(py, None);
        // Panics are told in the message.
        py.detach(|| drop(thread.join()));
        result
    })
}

fn named() -> thread::Builder {
    thread::Builder::new().name("sparsesplat".to_owned())
}

fn no_thread(error: &std::io::Error) -> PyErr {
    PyRuntimeError::new_err(format!("no thread to work on: {error}"))
}

/// What waits for work.
struct Ear<T> {
    receiver: Mutex<Receiver<Message<T>>>,
    gone: Arc<AtomicBool>,
}

/// The job of a thread, and what hears of it.
fn prepare<T: Send>(work: impl FnOnce(&Caller) -> T + Send) -> (impl FnOnce() + Send, Ear<T>) {
    let (sender, receiver) = mpsc::channel();
    let gone = Arc::new(AtomicBool::new(false));
    let ear = Ear { receiver: Mutex::new(receiver), gone: Arc::clone(&gone) };
    let job = move || {
        let telling = sender.clone();
        // A caller that is gone does not listen.
        let caller =
            Caller { gone, progress: &move |progress| drop(telling.send(Message::Progress(progress))) };
        let outcome = catch_unwind(AssertUnwindSafe(|| work(&caller)));
        drop(sender.send(Message::Done(outcome)));
    };
    (job, ear)
}

impl<T: Send> Ear<T> {
    /// Waits for the end of the work, detached from the interpreter.
    fn listen(self, py: Python<'_>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<T> {
        let leave = |error| {
            self.gone.store(true, Ordering::Relaxed);
            Err(error)
        };
        loop {
            if let Err(error) = py.check_signals() {
                return leave(error);
            }
            match py.detach(|| lock(&self.receiver).recv_timeout(SIGNALS)) {
                Ok(Message::Done(Ok(result))) => return Ok(result),
                // A broken invariant of ours: pyo3 makes a PanicException of it.
                Ok(Message::Done(Err(panic))) => resume_unwind(panic),
                Ok(Message::Progress(Progress { stage, share })) => {
                    let Some(progress) = progress else { continue };
                    if let Err(error) = progress.call1((stage, share)) {
                        return leave(error);
                    }
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(PyRuntimeError::new_err("the thread that worked is gone"));
                }
            }
        }
    }
}
