//! The exit codes, which scripts tell failures apart by.

use std::error::Error as StdError;
use std::fmt;
use std::process::ExitCode;

use super::Error;
use super::answer::{HullRefused, Refusal};
use super::checked::Malformed;
use super::scene::SceneError;

/// What the top-level help says of exit codes.
pub(crate) const HELP: &str = "\
Exit codes:
  0  success
  1  any other failure, such as a file that cannot be written, or a load run with failed calls
  2  a wrong option, or a wrong value of an option or a setting
  3  faulty input: a scene, hull, settings, token or PEM file
  4  no server can be reached, or the server that is there does not speak the protocol
  5  the server refused the call, or failed
  6  pairs are INVALID: unusable poses, or hulls that the server lost";

/// Why a command failed, as its exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Exit {
    /// None of the others.
    Failed = 1,
    /// A wrong option, or a wrong value of an option or a setting.
    Usage = 2,
    /// A file given by the user is faulty.
    Input = 3,
    /// There is no server, or none that speaks the protocol.
    Unreachable = 4,
    /// The server refused the call, or failed.
    Refused = 5,
    /// Pairs were not answered.
    Unanswered = 6,
}

/// A message with the exit code of its kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Failure {
    exit: Exit,
    text: String,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl StdError for Failure {}

impl Exit {
    /// An error of this kind.
    pub(crate) fn error(self, text: impl fmt::Display) -> Error {
        Failure { exit: self, text: text.to_string() }.into()
    }

    /// The kind of an error.
    fn of(error: &(dyn StdError + 'static)) -> Self {
        if let Some(failure) = error.downcast_ref::<Failure>() {
            failure.exit
        } else if let Some(refusal) = error.downcast_ref::<Refusal>() {
            refusal.exit
        } else if error.is::<Malformed>() {
            Self::Refused
        } else if error.is::<HullRefused>() || error.is::<SceneError>() {
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
