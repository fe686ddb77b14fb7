//! Shards of a sweep's windows, and the variables of cluster schedulers that select one.

use super::SweepError;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::str::FromStr;

/// One of `count` equal parts of the windows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shard {
    /// Which one, from 0.
    pub index: usize,
    /// How many there are, at least 1.
    pub count: usize,
}

impl Shard {
    /// All windows.
    pub const WHOLE: Self = Self { index: 0, count: 1 };

    /// More shards than this are a slip of the pen.
    const MOST: usize = 1_000_000;

    /// Whether it is one of its count, and the count within reason.
    pub(super) fn is_valid(self) -> bool {
        self.index < self.count && self.count <= Self::MOST
    }

    /// Whether the window at this position of the list belongs to the shard: they take turns.
    #[must_use]
    pub fn takes(self, position: usize) -> bool {
        position % self.count == self.index
    }

    /// What the scheduler of a cluster says by variables of the environment, which `get` looks up; none outside one.
    ///
    /// SLURM sets `SLURM_ARRAY_TASK_ID`, `_COUNT`, `_MIN` and `_STEP` in every task of a job array
    /// (<https://slurm.schedmd.com/job_array.html>). Kubernetes sets `JOB_COMPLETION_INDEX`, from 0, in the pods of an Indexed Job
    /// and nothing that says of how many; the manifest has to set `JOB_COMPLETIONS` to what it says in `completions`
    /// (<https://kubernetes.io/docs/tasks/job/indexed-parallel-processing-static>).
    ///
    /// # Errors
    /// If a variable is set and there is no shard that it could mean.
    pub fn of_environment(get: impl Fn(&str) -> Option<String>) -> Result<Option<Self>, SweepError> {
        const ID: &str = "SLURM_ARRAY_TASK_ID";
        const INDEX: &str = "JOB_COMPLETION_INDEX";
        let number = |variable: &'static str, rule: &'static str| {
            let Some(value) = get(variable) else { return Ok(None) };
            let parsed = value.trim().parse::<usize>();
            parsed.map(Some).map_err(|_| SweepError::Scheduler { variable, value, rule })
        };
        let refuse = |variable: &'static str, rule: &'static str| {
            let value = get(variable).unwrap_or_default();
            Err(SweepError::Scheduler { variable, value, rule })
        };
        const WHOLE_NUMBER: &str = "expected a whole number";
        if let Some(id) = number(ID, WHOLE_NUMBER)? {
            let Some(count) = number("SLURM_ARRAY_TASK_COUNT", WHOLE_NUMBER)? else {
                return refuse(ID, "SLURM_ARRAY_TASK_COUNT, which says of how many, is not set");
            };
            let first = number("SLURM_ARRAY_TASK_MIN", WHOLE_NUMBER)?.unwrap_or(0);
            let step = number("SLURM_ARRAY_TASK_STEP", WHOLE_NUMBER)?.unwrap_or(1).max(1);
            let index = id.checked_sub(first).map_or(usize::MAX, |above| above / step);
            if index >= count {
                return refuse(ID, "expected the ids of the array to be equally spaced, as in --array=0-7");
            }
            return Ok(Some(Self { index, count }));
        }
        if let Some(index) = number(INDEX, WHOLE_NUMBER)? {
            let Some(count) = number("JOB_COMPLETIONS", WHOLE_NUMBER)? else {
                return refuse(
                    INDEX,
                    "Kubernetes does not say of how many: set JOB_COMPLETIONS in the manifest",
                );
            };
            if index >= count {
                return refuse(INDEX, "expected less than JOB_COMPLETIONS");
            }
            return Ok(Some(Self { index, count }));
        }
        Ok(None)
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index, self.count)
    }
}

impl FromStr for Shard {
    type Err = SweepError;

    fn from_str(text: &str) -> Result<Self, SweepError> {
        // `parse` alone would take a plus sign.
        let number =
            |part: &str| part.bytes().all(|b| b.is_ascii_digit()).then(|| part.parse().ok()).flatten();
        let parts = text.split_once('/').and_then(|(i, n)| Some((number(i)?, number(n)?)));
        match parts {
            Some((index, count)) if (Self { index, count }).is_valid() => Ok(Self { index, count }),
            _ => Err(SweepError::Shard { text: text.to_owned() }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn environment(pairs: &[(&str, &str)]) -> Result<Option<Shard>, SweepError> {
        let find = |name: &str| pairs.iter().find(|(key, _)| *key == name).map(|(_, v)| (*v).to_owned());
        Shard::of_environment(find)
    }

    #[test]
    fn shards_are_written_as_index_and_count() {
        assert_eq!("2/4".parse::<Shard>().unwrap(), Shard { index: 2, count: 4 });
        assert_eq!(Shard { index: 2, count: 4 }.to_string(), "2/4");
        for bad in
            ["", "/", "1", "4/4", "0/0", "-1/4", "+1/4", "1/4/8", "a/4", " 1/4", "1/99999999999999999999"]
        {
            assert!(bad.parse::<Shard>().unwrap_err().to_string().contains("I/N"), "{bad}");
        }
    }

    #[test]
    fn every_window_belongs_to_one_shard() {
        for count in 1..6 {
            for position in 0..20 {
                let taking = (0..count).filter(|&index| Shard { index, count }.takes(position));
                assert_eq!(taking.count(), 1);
            }
        }
    }

    #[test]
    fn schedulers_are_understood() {
        assert_eq!(environment(&[]).unwrap(), None);
        let slurm = |id, count| [("SLURM_ARRAY_TASK_ID", id), ("SLURM_ARRAY_TASK_COUNT", count)];
        assert_eq!(environment(&slurm("3", "4")).unwrap(), Some(Shard { index: 3, count: 4 }));
        let from_one = [&slurm("4", "4")[..], &[("SLURM_ARRAY_TASK_MIN", "1")]].concat();
        assert_eq!(environment(&from_one).unwrap(), Some(Shard { index: 3, count: 4 }));
        let stepped =
            [&slurm("5", "3")[..], &[("SLURM_ARRAY_TASK_MIN", "1"), ("SLURM_ARRAY_TASK_STEP", "2")]].concat();
        assert_eq!(environment(&stepped).unwrap(), Some(Shard { index: 2, count: 3 }));
        let kubernetes = [("JOB_COMPLETION_INDEX", "0"), ("JOB_COMPLETIONS", "2")];
        assert_eq!(environment(&kubernetes).unwrap(), Some(Shard { index: 0, count: 2 }));
    }

    #[test]
    fn schedulers_that_say_too_little_are_refused_by_the_variables_name() {
        for (pairs, part) in [
            (&[("SLURM_ARRAY_TASK_ID", "1")][..], "SLURM_ARRAY_TASK_COUNT"),
            (&[("SLURM_ARRAY_TASK_ID", "x")], "whole number"),
            (&[("SLURM_ARRAY_TASK_ID", "7"), ("SLURM_ARRAY_TASK_COUNT", "3")], "equally spaced"),
            (&[("JOB_COMPLETION_INDEX", "1")], "JOB_COMPLETIONS"),
            (&[("JOB_COMPLETION_INDEX", "2"), ("JOB_COMPLETIONS", "2")], "less than"),
        ] {
            let error = environment(pairs).unwrap_err().to_string();
            assert!(error.contains(part) && error.contains("I/N"), "{error}");
        }
    }
}
