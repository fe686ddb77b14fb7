//! What the user typed, as against what is a default.

use crate::failure::{Failure, Outcome};
use clap::parser::ValueSource;
use clap::{ArgMatches, Command};
use std::collections::BTreeSet;

/// The settings that the user typed, by name: a setting that has no effect on what is asked for is an error, its default is none.
#[derive(Debug, Clone, Default)]
pub(crate) struct Given(BTreeSet<String>);

impl Given {
    /// What stands on a command line.
    pub(crate) fn of(command: &Command, matches: &ArgMatches) -> Self {
        let mut given = BTreeSet::new();
        let mut level = Some((command, matches));
        while let Some((command, matches)) = level {
            for argument in command.get_arguments() {
                let id = argument.get_id().as_str();
                if matches.value_source(id) == Some(ValueSource::CommandLine) {
                    given.insert(argument.get_long().unwrap_or(id).to_owned());
                }
            }
            let deeper = matches.subcommand();
            level = deeper.and_then(|(name, matches)| Some((command.find_subcommand(name)?, matches)));
        }
        Self(given)
    }

    /// Whether a setting, by its long name, was typed.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.0.contains(name)
    }

    /// Refuses settings that would have no effect.
    pub(crate) fn refuse(&self, names: &[&str], why: &str) -> Outcome {
        match names.iter().find(|name| self.has(name)) {
            Some(name) => Err(Failure::input(format!("--{name} has no effect here: {why}"))),
            None => Ok(()),
        }
    }

    /// Refuses all settings but some.
    pub(crate) fn refuse_all_but(&self, names: &[&str], why: &str) -> Outcome {
        let others: Vec<&str> =
            self.0.iter().map(String::as_str).filter(|name| !names.contains(name)).collect();
        self.refuse(&others, why)
    }
}
