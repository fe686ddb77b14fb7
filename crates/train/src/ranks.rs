//! The processes of a run: one, or those that MPI started together.

#[cfg(feature = "mpi")]
mod mpi;
#[cfg(test)]
mod threads;

/// The processes of a run, and the rank of this one among them, counted from 0. With the feature `mpi` there may be several:
/// `Ranks::of_mpi`.
///
/// If one process cannot go on, the others would wait for it for ever: whoever gets an error on one rank of several calls
/// [`Ranks::abort`]. A panic does so by itself.
pub struct Ranks {
    rank: usize,
    count: usize,
    /// None where one process is alone.
    exchange: Option<Box<dyn Exchange>>,
}

/// What the processes do together: each call is made on all ranks, in the same order.
trait Exchange: Send + Sync {
    /// Each number becomes its sum over the ranks, the same bits on each of them.
    fn sum(&self, values: &mut [f64]);
    /// The smallest and the largest of the ranks' numbers.
    fn range(&self, value: u64) -> (u64, u64);
    /// Returns when all ranks have called.
    fn wait(&self);
    /// Ends the processes of all ranks at once.
    fn abort(&self, code: u8);
}

impl Ranks {
    /// This process alone.
    #[must_use]
    pub fn alone() -> Self {
        Self { rank: 0, count: 1, exchange: None }
    }

    /// Rank of this process.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.rank
    }

    /// Number of processes.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Whether this is the rank that prints and writes files.
    #[must_use]
    pub fn is_first(&self) -> bool {
        self.rank == 0
    }

    /// Runs `work` on the first rank, and then on the others, which find in a common folder what the first one made.
    pub fn first_before_others<T>(&self, work: impl FnOnce() -> T) -> T {
        if !self.is_first() {
            self.wait();
            return work();
        }
        let made = work();
        self.wait();
        made
    }

    /// Ends the processes of all ranks at once, with this exit code.
    pub fn abort(&self, code: u8) -> ! {
        if let Some(exchange) = &self.exchange {
            exchange.abort(code);
        }
        std::process::exit(code.into())
    }

    /// Each number becomes its sum over the ranks, the same bits on each of them.
    pub(crate) fn sum(&self, values: &mut [f64]) {
        if let Some(exchange) = &self.exchange {
            exchange.sum(values);
        }
    }

    /// Whether all ranks call with the same number.
    pub(crate) fn agree(&self, value: u64) -> bool {
        self.exchange.as_ref().is_none_or(|exchange| {
            let (smallest, largest) = exchange.range(value);
            smallest == largest
        })
    }

    fn wait(&self) {
        if let Some(exchange) = &self.exchange {
            exchange.wait();
        }
    }
}

impl Drop for Ranks {
    fn drop(&mut self) {
        if let (Some(exchange), true) = (&self.exchange, std::thread::panicking()) {
            // The exit code of a panic.
            exchange.abort(101);
        }
    }
}
