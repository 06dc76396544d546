//! Adds to the help of the command line what the options' own texts do not have: the defaults of
//! the server's settings, the headings and the exit codes.

use clap::{Arg, Command};
use hullcast::size::ByteSize;

use super::exit;
use super::settings::PartialSettings;

/// The settings of the server by the subjects under which the help lists them.
const SUBJECTS: [(&str, &[&str]); 6] = [
    (
        "Addresses and store",
        &[
            "listen",
            "admin_listen",
            "playground",
            "grpc_web",
            "grpc_web_origins",
            "store",
            "store_bytes",
            "store_seconds",
        ],
    ),
    (
        "Who may connect",
        &[
            "tls_certificate",
            "tls_key",
            "tls_client_ca",
            "allow_plaintext",
            "query_tokens",
            "register_tokens",
            "reload_seconds",
            "trusted_proxies",
        ],
    ),
    ("Stopping", &["grace_seconds", "drain_seconds", "max_connection_age_seconds", "probe_seconds"]),
    ("Logs and traces", &["log", "log_format", "otlp_endpoint", "otlp_share"]),
    (
        "Records of calls",
        &["record", "record_bytes", "record_share", "record_slow_seconds", "record_failed", "record_flagged"],
    ),
    (
        "Limits",
        &[
            "compute_threads",
            "shares",
            "max_message_bytes",
            "max_pairs_per_request",
            "max_bodies_per_request",
            "max_hulls_per_request",
            "max_vertices_per_hull",
            "max_points_per_hull",
            "max_pairs_in_flight",
            "max_request_bytes_in_flight",
            "max_memory_bytes",
            "max_stream_state_bytes",
            "max_connections",
            "max_streams_per_connection",
            "max_deadline_seconds",
            "message_seconds",
            "answer_seconds",
            "max_page_size",
            "cache_bytes",
            "cache_age_seconds",
        ],
    ),
];

/// The command line with these additions.
pub(crate) fn complete(command: Command) -> Command {
    let defaults =
        toml::Table::try_from(PartialSettings::default().or(PartialSettings::default())).unwrap_or_default();
    let described = |arg: Arg| {
        let name = arg.get_id().to_string();
        let Some(default) = defaults.get(&name) else { return arg };
        let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
        let place = SUBJECTS.iter().position(|(_, names)| names.contains(&name.as_str()));
        let heading = place.map_or("Limits", |place| SUBJECTS[place].0);
        let size = default.as_integer().filter(|bytes| *bytes > 0 && name.contains("_bytes"));
        let default = size.map_or_else(|| shown(default), |bytes| ByteSize(bytes as u64).to_string());
        arg.help(format!("{help} [default: {default}]")).help_heading(heading)
    };
    command.after_help(exit::HELP).mut_subcommand("serve", |serve| serve.mut_args(described))
}

/// A setting's value as it is written on the command line.
fn shown(value: &toml::Value) -> String {
    match value {
        toml::Value::String(text) if text.is_empty() => "none".into(),
        toml::Value::String(text) => text.clone(),
        toml::Value::Array(values) if values.is_empty() => "none".into(),
        toml::Value::Array(values) => values.iter().map(shown).collect::<Vec<_>>().join(","),
        toml::Value::Float(number) => number.to_string(),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Arguments;
    use crate::cli::settings::NAMES;
    use clap::{ArgAction, CommandFactory};

    fn subcommands() -> Vec<Command> {
        let mut command = complete(Arguments::command());
        command.build();
        command.get_subcommands().filter(|command| command.get_name() != "help").cloned().collect()
    }

    /// Catches an option whose help does not state its default, and an option without a heading.
    #[test]
    fn every_option_has_its_default_and_a_heading() {
        let mut options = 0;
        for command in subcommands() {
            let of_own = |arg: &&Arg| !arg.is_positional() && arg.get_id() != "help" && !arg.is_hide_set();
            for arg in command.get_arguments().filter(of_own) {
                let name = format!("{} --{}", command.get_name(), arg.get_long().unwrap_or_default());
                let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
                let is_switch = matches!(arg.get_action(), ArgAction::SetTrue);
                let has_default = !arg.get_default_values().is_empty() || help.contains("[default: ");
                assert!(has_default || is_switch || arg.is_required_set(), "{name}: {help}");
                assert!(arg.get_help_heading().is_some(), "{name} has no heading");
                options += 1;
            }
        }
        assert!(options > 80, "{options} options seen");
    }

    /// Catches a setting that is listed under no subject, or under two.
    #[test]
    fn every_setting_has_one_subject() {
        let mut listed: Vec<&str> = SUBJECTS.iter().flat_map(|(_, names)| *names).copied().collect();
        let mut names = NAMES.to_vec();
        listed.sort_unstable();
        names.sort_unstable();
        assert_eq!(listed, names);
    }
}
