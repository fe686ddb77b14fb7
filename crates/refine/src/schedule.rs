//! The schedule: the views that a step compares, and its step size.

use crate::Stop;
use std::f64::consts::PI;
use std::time::Duration;

/// The views in rounds, each in an order of its own.
pub(crate) struct Turns {
    views: usize,
    seed: u64,
    round: u64,
    left: Vec<usize>,
}

impl Turns {
    pub(crate) fn new(views: usize, seed: u64) -> Self {
        Self { views, seed, round: 0, left: Vec::new() }
    }

    /// The next view.
    pub(crate) fn next(&mut self) -> usize {
        if self.left.is_empty() {
            self.round += 1;
            let place = |view: usize| mix(mix(self.seed ^ mix(self.round)) ^ view as u64);
            self.left = (0..self.views).collect();
            self.left.sort_by_key(|&view| (place(view), view));
        }
        self.left.pop().unwrap_or(0)
    }
}

/// SplitMix64's output function.
fn mix(z: u64) -> u64 {
    let z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Stop {
    /// Whether a refinement may come to have two halves; with a limit in seconds only its speed tells.
    pub(crate) fn may_be_long(self) -> bool {
        match self {
            Self::Steps(all) => all as f64 >= LONG,
            Self::Seconds(_) => true,
        }
    }

    /// How much of the way is behind, 0 to 1, after `steps` steps and `spent` time.
    pub(crate) fn progress(self, steps: usize, spent: Duration) -> f64 {
        let share = match self {
            Self::Steps(all) => steps as f64 / all as f64,
            Self::Seconds(all) => spent.as_secs_f64() / all,
        };
        // 0 / 0: there is no way to go.
        if share.is_nan() { 1.0 } else { share.min(1.0) }
    }
}

/// Fewest steps of a refinement that has two halves: shorter ones gain more by photographs alone.
const LONG: f64 = 120.0;

/// Factor of the step sizes in the second half: it begins with a scene that is nearly right.
const SECOND: f32 = 0.6;

/// The halves of a long refinement. A short one has no second.
#[derive(Debug)]
pub(crate) struct Halves {
    stop: Stop,
    /// Whether there is something for a second half to compare.
    possible: bool,
    /// Whether the first has nothing left to gain.
    first_is_over: bool,
    /// Steps done and progress when the second began.
    second: Option<(usize, f64)>,
}

impl Halves {
    pub(crate) fn new(stop: Stop, possible: bool) -> Self {
        Self { stop, possible, first_is_over: false, second: None }
    }

    /// Whether there are two, as far as can be told after so many steps and at this progress.
    fn are_two(&self, steps: usize, progress: f64) -> bool {
        let expected = match self.stop {
            Stop::Steps(all) => all as f64,
            Stop::Seconds(_) => steps as f64 / progress,
        };
        self.possible && expected >= LONG
    }

    /// Whether the second half begins with the next step.
    pub(crate) fn begin_second(&mut self, steps: usize, progress: f64) -> bool {
        let begins =
            self.second.is_none() && self.are_two(steps, progress) && (self.first_is_over || progress >= 0.5);
        if begins {
            self.second = Some((steps, progress));
        }
        begins
    }

    /// There is nothing left to gain; whether a second half follows.
    pub(crate) fn end_first(&mut self, steps: usize, progress: f64) -> bool {
        self.first_is_over = self.second.is_none() && self.are_two(steps, progress);
        self.first_is_over
    }

    /// Factor of the step sizes in this half.
    pub(crate) fn size(&self) -> f32 {
        if self.second.is_some() { SECOND } else { 1.0 }
    }

    /// Steps done in this half, and its progress.
    pub(crate) fn within(&self, steps: usize, progress: f64) -> (usize, f64) {
        match self.second {
            Some((before, began)) => (steps - before, (progress - began) / (1.0 - began)),
            None if self.are_two(steps, progress) => (steps, (2.0 * progress).min(1.0)),
            None => (steps, progress),
        }
    }
}

/// Factor of the step sizes: half a cosine from 1 to `last`.
pub(crate) fn decay(progress: f64, last: f32) -> f32 {
    let last = f64::from(last);
    (last + (1.0 - last) * 0.5 * (1.0 + (PI * progress).cos())) as f32
}

/// Factor of the size of the `step`-th step, counted from 1: even rise to 1.
pub(crate) fn rise(step: usize, warm_up: usize) -> f32 {
    if step < warm_up { step as f32 / warm_up as f32 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_round_has_every_view_once_in_an_order_of_its_seed() {
        let rounds = |seed| {
            let mut turns = Turns::new(6, seed);
            (0..10).map(|_| (0..6).map(|_| turns.next()).collect::<Vec<_>>()).collect::<Vec<_>>()
        };
        for round in rounds(3) {
            let mut sorted = round.clone();
            sorted.sort_unstable();
            assert_eq!(sorted, [0, 1, 2, 3, 4, 5]);
        }
        assert!(rounds(3).windows(2).any(|pair| pair[0] != pair[1]));
        assert!(rounds(3) == rounds(3) && rounds(3) != rounds(4));
        assert_eq!(Turns::new(1, 0).next(), 0);
    }

    #[test]
    fn long_ways_have_two_halves_and_short_ones_one() {
        let mut short = Halves::new(Stop::Steps(119), true);
        assert!(!short.begin_second(80, 80.0 / 119.0) && !short.end_first(80, 0.7));
        assert_eq!(short.within(60, 0.25), (60, 0.25));
        assert!(!Stop::Steps(119).may_be_long() && Stop::Steps(120).may_be_long());
        let mut alone = Halves::new(Stop::Steps(500), false);
        assert!(!alone.begin_second(400, 0.8) && !alone.end_first(400, 0.8));

        let mut halves = Halves::new(Stop::Steps(200), true);
        assert_eq!((halves.within(50, 0.25), halves.size()), ((50, 0.5), 1.0));
        assert!(!halves.begin_second(99, 0.495) && halves.begin_second(100, 0.5));
        assert!(!halves.begin_second(101, 0.505), "it begins once");
        assert_eq!((halves.within(100, 0.5), halves.within(150, 0.75)), ((0, 0.0), (50, 0.5)));
        assert!(!halves.end_first(150, 0.75) && halves.size() < 1.0);

        let mut early = Halves::new(Stop::Steps(1000), true);
        assert!(early.end_first(200, 0.2) && early.begin_second(201, 0.25));
        assert_eq!(early.within(401, 0.5), (200, 1.0 / 3.0));

        let mut timed = Halves::new(Stop::Seconds(10.0), true);
        assert_eq!(timed.within(0, 0.0), (0, 0.0));
        assert!(!timed.begin_second(40, 0.5), "80 steps fit into the time");
        assert!(timed.begin_second(60, 0.5));
    }

    #[test]
    fn step_sizes_rise_evenly_to_one() {
        assert_eq!([1, 2, 3, 4, 5].map(|step| rise(step, 4)), [0.25, 0.5, 0.75, 1.0, 1.0]);
        assert_eq!([rise(1, 0), rise(1, 1), rise(2, 1)], [1.0; 3]);
    }

    #[test]
    fn step_sizes_fall_from_one_to_the_last() {
        let size = |steps| decay(Stop::Steps(10).progress(steps, Duration::ZERO), 0.05);
        assert_eq!((size(0), size(10), size(20)), (1.0, 0.05, 0.05));
        assert!((0..10).all(|step| size(step) > size(step + 1)));
        let half = Stop::Seconds(2.0).progress(7, Duration::from_secs(1));
        assert_eq!(half, 0.5);
        assert_eq!(Stop::Steps(0).progress(0, Duration::ZERO), 1.0);
        assert_eq!(Stop::Seconds(0.0).progress(0, Duration::ZERO), 1.0);
    }
}
