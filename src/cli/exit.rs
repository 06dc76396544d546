//! The exit codes, by which scripts distinguish failures.

use std::error::Error as StdError;
use std::fmt;
use std::process::ExitCode;

use hullcast_client::HullRefused;

use super::Error;
use super::answer::QueryRefusal;
use super::scene::SceneFileError;

/// The part of the top-level help about exit codes.
pub(crate) const HELP: &str = "\
Exit codes:
  0  success
  1  any other failure, such as a file that cannot be written, or a load run with failed calls
  2  a wrong option, or a wrong value of an option or a setting
  3  faulty input: a scene, hull, settings, token or PEM file
  4  no server can be reached, or the server that is there does not speak the protocol
  5  the server refused the call, or failed
  6  pairs are INVALID: unusable poses, or hulls that the server lost";

/// The kinds of failure, each with its exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Exit {
    /// A failure of no other kind.
    Failed = 1,
    /// A wrong option, or a wrong value of an option or a setting.
    Usage = 2,
    /// A file from the user is faulty.
    Input = 3,
    /// No server answers, or the peer does not speak the protocol.
    Unreachable = 4,
    /// The server refused the call, or failed.
    Refused = 5,
    /// Pairs were not answered.
    Unanswered = 6,
}

/// An error message with the exit code of its kind.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub(crate) struct Failure {
    exit: Exit,
    text: String,
}

impl Exit {
    /// An error of this kind.
    pub(crate) fn error(self, text: impl fmt::Display) -> Error {
        Failure { exit: self, text: text.to_string() }.into()
    }

    /// The kind of an error.
    fn of(error: &(dyn StdError + 'static)) -> Self {
        if let Some(failure) = error.downcast_ref::<Failure>() {
            failure.exit
        } else if let Some(refusal) = error.downcast_ref::<QueryRefusal>() {
            refusal.exit
        } else if error.is::<HullRefused>() || error.is::<SceneFileError>() {
            Self::Input
        } else {
            Self::Failed
        }
    }
}

/// The exit code of a command that failed.
pub(crate) fn code(error: &Error) -> ExitCode {
    ExitCode::from(Exit::of(error.as_ref()) as u8)
}
