//! The settings of a server. A flag takes precedence over the environment, the environment over the
//! file, and the file over the default.

mod checked;
mod declared;
mod file;

pub(crate) use checked::CheckedSettings;
#[cfg(test)]
pub(crate) use declared::NAMES;
pub(crate) use declared::{DEFAULT_STORE, LogFormat, MOST_THREADS, PartialSettings, Settings};
#[cfg(test)]
pub(crate) use file::SettingsFileError;
