//! Ranks that are threads of one process, for tests.

use super::{Exchange, Ranks};
use std::sync::{Arc, Barrier, Mutex};

struct Shared {
    barrier: Barrier,
    /// What each rank gave, by rank.
    given: Mutex<Vec<Vec<f64>>>,
}

struct Thread {
    rank: usize,
    shared: Arc<Shared>,
}

impl Ranks {
    /// So many ranks, each for a thread of its own.
    pub(crate) fn of_threads(count: usize) -> Vec<Self> {
        let given = Mutex::new(vec![Vec::new(); count]);
        let shared = Arc::new(Shared { barrier: Barrier::new(count), given });
        let thread = |rank| -> Box<dyn Exchange> { Box::new(Thread { rank, shared: Arc::clone(&shared) }) };
        (0..count).map(|rank| Self { rank, count, exchange: Some(thread(rank)) }).collect()
    }
}

impl Thread {
    /// What all ranks give, by rank.
    fn gathered(&self, values: &[f64]) -> Vec<Vec<f64>> {
        self.shared.given.lock().unwrap()[self.rank] = values.to_vec();
        self.wait();
        let all = self.shared.given.lock().unwrap().clone();
        // Nobody gives anew before all have read.
        self.wait();
        all
    }
}

impl Exchange for Thread {
    fn sum(&self, values: &mut [f64]) {
        let all = self.gathered(values);
        values.iter_mut().enumerate().for_each(|(i, sum)| *sum = all.iter().map(|given| given[i]).sum());
    }

    fn range(&self, value: u64) -> (u64, u64) {
        let all = self.gathered(&[f64::from_bits(value)]);
        let values = || all.iter().map(|given| given[0].to_bits());
        (values().min().unwrap(), values().max().unwrap())
    }

    fn wait(&self) {
        self.shared.barrier.wait();
    }

    fn abort(&self, code: u8) {
        std::process::exit(code.into());
    }
}
