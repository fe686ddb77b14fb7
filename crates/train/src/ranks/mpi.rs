use super::{Exchange, Ranks};
use crate::{Error, Result};
use mpi::Threading;
use mpi::collective::SystemOperation;
use mpi::environment::Universe;
use mpi::traits::{Communicator, CommunicatorCollectives};

impl Ranks {
    /// All processes that `mpirun` or a scheduler started together. A process that was started by itself is alone. MPI ends in this
    /// process when the value is dropped.
    ///
    /// # Errors
    /// If MPI was started in this process before.
    pub fn of_mpi() -> Result<Self> {
        // One thread at a time calls MPI; whether it is the main thread is up to the caller.
        let (universe, _) =
            mpi::initialize_with_threading(Threading::Serialized).ok_or(Error::MpiAlreadyStarted)?;
        let world = universe.world();
        Ok(Self {
            rank: world.rank() as usize,
            count: world.size() as usize,
            exchange: Some(Box::new(universe)),
        })
    }
}

impl Exchange for Universe {
    fn sum(&self, values: &mut [f64]) {
        let contribution = values.to_vec();
        self.world().all_reduce_into(&contribution[..], values, SystemOperation::sum());
    }

    fn range(&self, value: u64) -> (u64, u64) {
        let (mut smallest, mut largest) = (value, value);
        self.world().all_reduce_into(&value, &mut smallest, SystemOperation::min());
        self.world().all_reduce_into(&value, &mut largest, SystemOperation::max());
        (smallest, largest)
    }

    fn wait(&self) {
        self.world().barrier();
    }

    fn abort(&self, code: u8) {
        self.world().abort(code.into());
    }
}
