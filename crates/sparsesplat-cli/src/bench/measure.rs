//! Timed runs, taken in turns so that a machine that slows down slows all rows alike.

use crate::failure::{OrFail, Outcome};
use crate::threads;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::time::{Duration, Instant};

/// Cores that had nothing to do take as long to work at their full speed.
const WARM_UP: Duration = Duration::from_millis(60);

/// Of several numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spread {
    pub(super) median: f64,
    pub(super) least: f64,
    pub(super) most: f64,
}

impl Spread {
    /// Of at least one number; of an even number of them the median is the upper one.
    pub(super) fn of(mut numbers: Vec<f64>) -> Self {
        numbers.sort_by(f64::total_cmp);
        Self { median: numbers[numbers.len() / 2], least: numbers[0], most: numbers[numbers.len() - 1] }
    }
}

/// What a job took, and what its timed runs found.
#[derive(Debug)]
pub(super) struct Measured<T> {
    pub(super) seconds: Spread,
    pub(super) found: Vec<T>,
    /// Most memory that the process held while the job ran first.
    pub(super) peak_rss_bytes: Option<u64>,
}

/// Measures every job `runs` times: round by round, each job in its turn, each timed run after others that are
/// not timed, so that it finds caches and cores as a series of runs would. `run` returns what it found and its seconds.
pub(super) fn measure<J, T>(
    jobs: &[J],
    runs: usize,
    run: &mut dyn FnMut(&J) -> Outcome<(T, f64)>,
    on_run: &mut dyn FnMut(&J),
) -> Outcome<Vec<Measured<T>>> {
    let mut timed: Vec<(Vec<T>, Vec<f64>)> = jobs.iter().map(|_| (Vec::new(), Vec::new())).collect();
    let mut peaks = Vec::with_capacity(jobs.len());
    for round in 0..runs {
        for (job, (found, seconds)) in jobs.iter().zip(&mut timed) {
            on_run(job);
            if round == 0 {
                evaluate::restart_peak_rss();
            }
            let warm_up = Instant::now();
            run(job)?;
            if round == 0 {
                peaks.push(evaluate::peak_rss_bytes());
            }
            while warm_up.elapsed() < WARM_UP {
                run(job)?;
            }
            let (what, taken) = run(job)?;
            found.push(what);
            seconds.push(taken);
        }
    }
    let measured = timed.into_iter().zip(peaks).map(|((found, seconds), peak_rss_bytes)| Measured {
        seconds: Spread::of(seconds),
        found,
        peak_rss_bytes,
    });
    Ok(measured.collect())
}

/// What some work gives on the threads of a pool, and its seconds: those of its own, not those that it waits to begin.
pub(super) fn timed<T: Send>(
    pool: &ThreadPool,
    work: impl FnOnce() -> Outcome<T> + Send,
) -> Outcome<(T, f64)> {
    pool.install(|| {
        let begin = Instant::now();
        let found = work()?;
        Ok((found, begin.elapsed().as_secs_f64()))
    })
}

/// One thread, two, and all that work.
pub(super) fn pools() -> Outcome<Vec<ThreadPool>> {
    let mut counts = vec![1, 2.min(threads()), threads()];
    counts.dedup();
    counts.into_iter().map(|n| ThreadPoolBuilder::new().num_threads(n).build().or_work()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jobs_run_in_turns_and_untimed_runs_do_not_count() {
        let mut order = Vec::new();
        let mut calls = [0.0; 2];
        let mut run = |&job: &usize| {
            std::thread::sleep(WARM_UP);
            calls[job] += 1.0;
            Ok((job, calls[job]))
        };
        let measured = measure(&[0, 1], 3, &mut run, &mut |&job| order.push(job)).unwrap();
        assert_eq!(order, [0, 1, 0, 1, 0, 1]);
        for (job, measured) in measured.iter().enumerate() {
            // Each second call is a timed one.
            assert_eq!(measured.seconds, Spread { median: 4.0, least: 2.0, most: 6.0 });
            assert_eq!(measured.found, [job; 3]);
        }
    }
}
