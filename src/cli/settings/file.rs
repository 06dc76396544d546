//! Reads settings from a TOML file.
//!
//! The values of a file are turned into flags and parsed as flags, so that both have the same forms, ranges and
//! errors.

use std::path::Path;

use clap::{
    Arg, ArgAction, Args, Command, FromArgMatches,
    builder::Resettable,
    error::{ContextKind, ContextValue},
};
use hullcast::small_file;

use super::{
    checked::AT_LEAST_ONE,
    declared::{NAMES, PartialSettings},
};
use crate::cli::{Error, exit::Exit, values::did_you_mean};

impl PartialSettings {
    /// Reads a TOML file. Its values are checked as those of flags are. An unknown key is an error.
    pub(crate) fn read(path: &Path) -> Result<Self, Error> {
        let failure = |exit: Exit, why: &str| exit.error(format!("--config {}: {why}", path.display()));
        let content = small_file::read(path)
            .map_err(|error| failure(Exit::Input, &format!("cannot be read: {error}")))?;
        let text = str::from_utf8(&content).map_err(|error| failure(Exit::Input, &error.to_string()))?;
        Self::parse(text).map_err(|why| match why {
            SettingsFileError::Text(why) => failure(Exit::Input, &why),
            SettingsFileError::Value(why) => failure(Exit::Usage, &why),
        })
    }

    pub(crate) fn parse(text: &str) -> Result<Self, SettingsFileError> {
        let table: toml::Table = text.parse().map_err(|error| SettingsFileError::of_text(text, &error))?;
        let command = values_only();
        let defaults = toml::Table::try_from(Self::default().or(Self::default()))
            .map_err(|error| SettingsFileError::Text(error.to_string()))?;
        let mut line = Vec::new();
        for (key, value) in &table {
            if !NAMES.contains(&key.as_str()) {
                let near = did_you_mean(key, NAMES.iter().copied());
                return Err(SettingsFileError::Text(format!(
                    "there is no setting `{key}`{near} (`hullcast serve --print-config` prints all settings)"
                )));
            }
            let flags = flags(key, value, &command, defaults.get(key))?;
            checked(&command, key, &flags)?;
            line.extend(flags);
        }
        let matches = command
            .try_get_matches_from(line)
            .map_err(|error| SettingsFileError::Value(error.to_string()))?;
        Self::from_arg_matches(&matches).map_err(|error| SettingsFileError::Value(error.to_string()))
    }
}

/// The fault of a file of settings.
#[derive(Debug)]
pub(crate) enum SettingsFileError {
    /// The text is not TOML, or has an unknown key.
    Text(String),
    /// A setting has a wrong value.
    Value(String),
}

impl SettingsFileError {
    /// The fault of a text that is not TOML, with its line. If the cause is the value of a setting, such as a
    /// number with too many digits, the error also names the allowed values.
    fn of_text(text: &str, error: &toml::de::Error) -> Self {
        let before = text.get(..error.span().map_or(0, |span| span.start)).unwrap_or(text);
        let number = 1 + before.matches('\n').count();
        let line = text.lines().nth(number - 1).unwrap_or_default();
        let value = line.split_once('=').map(|(key, value)| (key.trim(), value.trim()));
        let known =
            value.filter(|(key, value)| NAMES.contains(key) && !value.starts_with(['[', '{', '"', '\'']));
        let refused = known.and_then(|(key, value)| {
            checked(&values_only(), key, &[format!("--{}={value}", key.replace('_', "-"))]).err()
        });
        if let Some(Self::Value(why)) = refused {
            return Self::Text(format!("line {number}: {why}"));
        }
        let why = error.message().replace('\n', ", ");
        Self::Text(format!(
            "line {number}: {why}: {:?}; expected TOML, as in max_page_size = 1000",
            line.trim()
        ))
    }
}

/// A command line that has only the flags of the settings. It reads no environment variables.
fn values_only() -> Command {
    let command = Command::new("settings").no_binary_name(true).disable_help_flag(true);
    PartialSettings::augment_args(command).mut_args(|arg| arg.env(Resettable::Reset))
}

/// A setting of a file as flags: one flag per entry of a list, and no flag for an empty value that is the
/// default. The settings that are lists are those whose flags `command` lets repeat.
fn flags(
    key: &str,
    value: &toml::Value,
    command: &Command,
    default: Option<&toml::Value>,
) -> Result<Vec<String>, SettingsFileError> {
    let is_repeated = |arg: &Arg| arg.get_id() == key && matches!(arg.get_action(), ArgAction::Append);
    let flag = |value: &toml::Value| match value {
        toml::Value::String(text) => format!("--{}={text}", key.replace('_', "-")),
        other => format!("--{}={other}", key.replace('_', "-")),
    };
    match value {
        toml::Value::Array(values) if values.is_empty() && key == "listen" => {
            Err(SettingsFileError::Value(format!("listen is [], {AT_LEAST_ONE}")))
        }
        toml::Value::Array(values) if command.get_arguments().any(is_repeated) => {
            Ok(values.iter().map(flag).collect())
        }
        toml::Value::Array(_) | toml::Value::Table(_) => {
            Err(SettingsFileError::Value(format!("{key} is {value}, must be a single value")))
        }
        toml::Value::String(text) if text.is_empty() && Some(value) == default => Ok(Vec::new()),
        value => Ok(vec![flag(value)]),
    }
}

/// Checks the flags of one setting. The error names the setting, its value and what is allowed.
fn checked(command: &Command, key: &str, flags: &[String]) -> Result<(), SettingsFileError> {
    let Err(error) = command.clone().try_get_matches_from(flags) else { return Ok(()) };
    let value = match error.get(ContextKind::InvalidValue) {
        Some(ContextValue::String(value)) => value.clone(),
        _ => flags.iter().filter_map(|flag| flag.split_once('=')).map(|(_, value)| value).collect(),
    };
    let allowed = match (std::error::Error::source(&error), error.get(ContextKind::ValidValue)) {
        (Some(why), _) => why.to_string(),
        (None, Some(ContextValue::Strings(allowed))) => format!("[possible values: {}]", allowed.join(", ")),
        (None, _) => error.kind().to_string(),
    };
    Err(SettingsFileError::Value(format!("{key} is {value:?}: {allowed}")))
}

#[cfg(test)]
mod tests {
    use std::net::IpAddr;

    use hullcast::size::ByteSize;

    use super::*;
    use crate::cli::{memory::MemorySize, settings::declared::Switch};

    fn refused(text: &str) -> String {
        match PartialSettings::parse(text).expect_err(text) {
            SettingsFileError::Text(why) | SettingsFileError::Value(why) => why,
        }
    }

    /// Catches a list, a number or a text in a file that is read as another kind of value, and a size
    /// with a unit that is not.
    #[test]
    fn values_of_a_file_are_those_of_flags() {
        let text = r#"
            listen = ["127.0.0.1:1", "unix:a"]
            trusted_proxies = []
            admin_listen = ""
            tls_key = ""
            playground = true
            grace_seconds = 3
            max_message_bytes = "32MiB"
            cache_bytes = "25%"
            shares = "off"
        "#;
        let given = PartialSettings::parse(text).unwrap();
        assert_eq!(given.listen.unwrap(), ["127.0.0.1:1", "unix:a"]);
        assert_eq!(given.trusted_proxies.unwrap_or_default(), [] as [IpAddr; 0]);
        assert_eq!((given.playground, given.grace_seconds), (Some(true), Some(3.0)));
        assert_eq!(given.max_message_bytes, Some(ByteSize(32 << 20)));
        assert_eq!((given.cache_bytes, given.shares), (Some(MemorySize::Share(25.0)), Some(Switch::Off)));
        for (text, why) in [
            ("log = [\"info\"]", "log is [\"info\"], must be a single value"),
            ("listen = []", "listen is [], must have at least one address"),
            ("listen = [\"\"]", "listen is \"\": expected host:port"),
            ("listen = \"\"", "listen is \"\": expected host:port"),
            ("log = \"info\"\nlog = \"warn\"", "duplicate key"),
            ("[listen]\nport = 1", "must be a single value"),
        ] {
            assert!(refused(text).contains(why), "{text}: {}", refused(text));
        }
    }

    /// Catches a misspelt key in a file that silently means the default.
    #[test]
    fn unknown_keys_are_refused() {
        let error = refused("cache_byte = 1");
        assert!(error.contains("`cache_byte`; did you mean `cache_bytes`?"), "{error}");
        assert!(!refused("nothing_like_it = 1").contains("did you mean"));
        assert_eq!(
            PartialSettings::parse("cache_bytes = 1").unwrap().cache_bytes,
            Some(MemorySize::Bytes(1))
        );
    }

    /// Catches settings that `--print-config` writes and `--config` cannot read.
    #[test]
    fn printed_settings_read_back() {
        let settings = PartialSettings::default().or(PartialSettings::default());
        let printed = toml::to_string(&settings).unwrap();
        let read = PartialSettings::parse(&printed).unwrap();
        assert_eq!(read.or(PartialSettings::default()), settings);
    }
}
