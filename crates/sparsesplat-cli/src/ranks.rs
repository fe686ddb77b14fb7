//! Runs on several processes that MPI started together.

#[cfg(not(feature = "mpi"))]
use crate::failure::Failure;
#[cfg(feature = "mpi")]
use crate::failure::OrFail;
use crate::failure::Outcome;
use crate::summary::{say_errors_only, tell};
use std::sync::Arc;
use train::Ranks;

/// Does work on all ranks. The first one speaks; one that fails ends the others, which would wait for it for ever.
pub(crate) fn on_ranks(work: impl FnOnce(&Arc<Ranks>) -> Outcome) -> Outcome {
    let ranks = Arc::new(started()?);
    if !ranks.is_first() {
        say_errors_only();
    }
    let outcome = work(&ranks);
    if let (Err(failure), 2..) = (&outcome, ranks.count()) {
        tell(&format!("error: rank {}: {failure}\n", ranks.rank()));
        ranks.abort(failure.code());
    }
    outcome
}

#[cfg(feature = "mpi")]
fn started() -> Outcome<Ranks> {
    Ranks::of_mpi().or_work()
}

/// This process alone, if it is not one of several.
#[cfg(not(feature = "mpi"))]
fn started() -> Outcome<Ranks> {
    // What OpenMPI tells the processes that it starts, and what the process managers of MPICH and SLURM do.
    let several = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE"].into_iter().find(|name| {
        let size = std::env::var(name).ok().and_then(|size| size.parse::<usize>().ok());
        size.is_some_and(|size| size > 1)
    });
    match several {
        Some(name) => Err(Failure::input(format!(
            "{name} is above 1: MPI started several processes, but this program was built without MPI: build sparsesplat-cli with the \
             feature `mpi`"
        ))),
        None => Ok(Ranks::alone()),
    }
}
