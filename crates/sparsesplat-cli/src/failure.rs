//! How a command can fail, and the exit code that says so.

use std::fmt::Display;
use view_data::Unposed;

/// Why a command gave up.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The arguments or the files that were given are wrong: exit code 2.
    Input(anyhow::Error),
    /// The same with an explanation of several lines.
    Explained(String),
    /// Something went wrong at work: exit code 1.
    Work(anyhow::Error),
}

/// What a command returns.
pub(crate) type Outcome<T = ()> = Result<T, Failure>;

impl Failure {
    /// Wrong input, by a rule of the command itself.
    pub(crate) fn input(rule: impl Display) -> Self {
        Self::Input(anyhow::anyhow!("{rule}"))
    }

    /// Wrong input, explained on several lines.
    pub(crate) fn lines(text: String) -> Self {
        Self::Explained(text)
    }

    /// Work that failed, by a rule of the command itself.
    pub(crate) fn work(rule: impl Display) -> Self {
        Self::Work(anyhow::anyhow!("{rule}"))
    }

    /// Data that cannot be read and views that do not suffice are the caller's to mend, the rest is ours.
    pub(crate) fn sorted(error: impl Into<evaluate::Error>) -> Self {
        use evaluate::Error::{Predict, Window};
        match error.into() {
            error @ (Predict(_)
            | Window(scene_windows::Error::Data(_) | scene_windows::Error::Predict(_))) => {
                Self::Input(error.into())
            }
            error => Self::Work(error.into()),
        }
    }

    /// The exit code.
    pub(crate) fn code(&self) -> u8 {
        match self {
            Self::Input(_) | Self::Explained(_) => 2,
            Self::Work(_) => 1,
        }
    }
}

/// The argument that does what the error of a library advises: libraries know nothing of arguments.
fn argument(error: &anyhow::Error) -> Option<&'static str> {
    error.chain().find_map(|cause| {
        // An error that only wraps another does not stand before it in the chain, but in its place.
        type Cause<'a> = &'a (dyn std::error::Error + 'static);
        let cause: Cause<'_> = match cause.downcast_ref() {
            Some(evaluate::Error::Window(error)) => error,
            Some(evaluate::Error::Predict(error)) => error,
            _ => cause,
        };
        let cause: Cause<'_> = match cause.downcast_ref() {
            Some(scene_windows::Error::Data(error)) => error,
            Some(scene_windows::Error::Predict(error)) => error,
            _ => cause,
        };
        let cause: Cause<'_> = match cause.downcast_ref() {
            Some(sparsesplat::Error::Backbone(error)) => error,
            _ => cause,
        };
        if let Some(error) = cause.downcast_ref::<view_data::Error>() {
            return match error {
                view_data::Error::MixedSizes { .. } => Some("--size WxH"),
                view_data::Error::TooFewFrames { .. } => Some("--views N"),
                view_data::Error::NoPoses { found: Unposed::Photographs(_) | Unposed::Video, .. } => {
                    Some("`sparsesplat poses INPUT -o SCENE` estimates them, then give SCENE; or reconstruct INPUT --poses -o scene.ply")
                }
                view_data::Error::Disconnected { connected, .. } if *connected >= 2 => Some("--views N"),
                _ => None,
            };
        }
        if let Some(depth_backbone::Error::RangeUnknown { .. }) = cause.downcast_ref() {
            return Some("--depth-range NEAR,FAR");
        }
        if let Some(scene_windows::Error::NoDepthHint { .. }) = cause.downcast_ref() {
            return Some("--depth-range estimate or NEAR,FAR");
        }
        if let Some(tradeoff::SweepError::Scheduler { .. }) = cause.downcast_ref() {
            return Some("--shard I/N");
        }
        None
    })
}

/// The error with its causes, on one line, and the argument that helps.
impl Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Input(error) | Self::Work(error) => {
                write!(f, "{}", format!("{error:#}").replace('\n', " "))?;
                argument(error).map_or(Ok(()), |argument| write!(f, " ({argument})"))
            }
            Self::Explained(text) => f.write_str(text),
        }
    }
}

/// Sorts an error into one of the two kinds.
pub(crate) trait OrFail<T> {
    /// The caller gave something wrong.
    fn or_input(self) -> Outcome<T>;
    /// The work failed.
    fn or_work(self) -> Outcome<T>;
}

impl<T, E: Into<anyhow::Error>> OrFail<T> for Result<T, E> {
    fn or_input(self) -> Outcome<T> {
        self.map_err(|error| Failure::Input(error.into()))
    }

    fn or_work(self) -> Outcome<T> {
        self.map_err(|error| Failure::Work(error.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use depth_backbone::Error::{NothingMeasured, RangeUnknown};

    #[test]
    fn the_argument_that_helps_is_named_once_and_only_where_it_helps() {
        let told = |error| Failure::sorted(sparsesplat::Error::Backbone(error)).to_string();
        let stereo = told(RangeUnknown { reason: "too few matches" });
        assert_eq!(stereo.matches("--depth-range NEAR,FAR").count(), 1, "{stereo}");
        assert_eq!(told(NothingMeasured), "the measured depth maps are empty");
        let of_a_window = scene_windows::Error::Predict(sparsesplat::Error::Backbone(RangeUnknown {
            reason: "too few matches",
        }));
        assert_eq!(Failure::sorted(evaluate::Error::Window(of_a_window)).to_string(), stereo);
    }

    #[test]
    fn every_cause_is_told_once() {
        let setting =
            || refine::Error::Setting { name: "damping", found: -1.0, expected: "a number above 0" };
        let looks = || sparsesplat::Error::Looks(Box::new(setting()));
        let metric = image_metrics::Error::GradientLength { expected: 6, found: 3 };
        let errors = [
            (evaluate::Error::Refine(setting()), "refinement setting damping"),
            (evaluate::Error::Predict(looks()), "refinement setting damping"),
            (evaluate::Error::Window(scene_windows::Error::Predict(looks())), "refinement setting damping"),
            (evaluate::Error::Metric { view: "left".to_owned(), source: metric }, "6"),
        ];
        for (error, cause) in errors {
            let told = Failure::sorted(error).to_string();
            assert_eq!(told.matches(cause).count(), 1, "{told}");
            assert_eq!(told.matches(": ").count(), 1, "one cause behind what it caused: {told}");
        }
    }
}
