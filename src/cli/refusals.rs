//! Tests every option with wrong values. The message must name the option, the value and the
//! allowed values.

use std::collections::BTreeSet;

use clap::{Arg, ArgAction, Command, CommandFactory};

use super::{
    help::complete,
    settings::{NAMES, PartialSettings, SettingsFileError},
};
use crate::Arguments;

/// Texts that are not numbers, or not finite numbers of at least 0.
const NO_NUMBERS: [&str; 11] = ["", " ", "abc", "nan", "-1", "-inf", "1,5", "0x10", "1e", "1 2", "ten"];
/// Texts that are not whole numbers of 64 bits.
const NO_COUNTS: [&str; 6] = ["1.5", "1e3", "inf", "99999999999999999999", "-0.5", "½"];
const NO_NAMES: [&str; 10] = ["", " ", "x", "1", "-", "none", "alpha;normal", "*", "ünknown", "true,"];
const NO_SWITCHES: [&str; 10] = ["", " ", "maybe", "2", "-1", "yes", "oui", "truee", "nil", "1.0"];
const NO_ADDRESSES: [&str; 10] =
    ["x", ":1", "a:", "a:65536", "a:-1", "::1:1", "a b:1", "[a]:1", "a:b:c", "ftp://a:1"];
const NO_ORIGINS: [&str; 7] = [
    "*",
    "null",
    "app.example.org",
    "ftp://app.example.org",
    "https://a.example/",
    "https://a:0",
    "https://",
];
const NO_PROXIES: [&str; 10] =
    ["", "x", "10.0.0", "10.0.0.1:5", "10.0.0.0/8", "[::1]", "256.0.0.1", "localhost", "::g", "10.0.0.1;::1"];
const NO_SERVERS: [&str; 10] =
    ["", ":1", "host:", "host:0", "host:65536", "host:x", "ftp://host", "http://a/b", "::1", "a b"];

const OUTPUTS: &str = "[possible values: outcome, alpha, normal, points, witness-b, features, bases, diagnostics, alpha-gradient, separation-gradient, normal-jacobian]";
const SIZE: &str = "to 1024 TiB (a number of bytes, or with KiB, MiB, GiB or TiB), or a percentage of the memory above 0% and up to 100%";

/// An option, its values that have the right type but are outside the range, and the text about the
/// allowed values.
type Case = (&'static str, &'static [&'static str], &'static str);

const OF_ANY_QUERY: [Case; 7] = [
    ("solver", &NO_NAMES, "[possible values: portal, gjk-ray-cast]"),
    ("relative-tolerance", &["1.01", "2", "inf"], "expected a number from 0 to 1"),
    ("feature-angle", &["0.51", "inf"], "expected a number from 0 to 0.5"),
    ("max-points", &["4294967296"], "expected a whole number from 0 to 4294967295"),
    ("margin", &["-0.1"], "expected a number of at least 0, or inf"),
    ("outputs", &NO_NAMES, OUTPUTS),
    ("threads", &["4097"], "expected a whole number from 0 to 4096"),
];
const OF_LOAD: [Case; 17] = [
    ("bodies", &["0", "4294967296"], "expected a whole number from 1 to 4294967295"),
    ("moved", &["-0.1", "1.1", "inf"], "expected a number from 0 to 1"),
    ("churn", &["-0.1", "1.1", "inf"], "expected a number from 0 to 1"),
    ("family", &NO_NAMES, "[possible values: box, poly16, poly64, poly256]"),
    ("regime", &NO_NAMES, "[possible values: shallow, resting, separated]"),
    ("request-distribution", &NO_NAMES, "[possible values: constant, poisson]"),
    ("pairs", &["0", "4294967296"], "expected a whole number from 1 to 4294967295"),
    ("batches", &["0", "4294967296"], "expected a whole number from 1 to 4294967295"),
    ("seed", &["18446744073709551616"], "expected a whole number from 0 to 18446744073709551615"),
    ("concurrency", &["0", "4294967296"], "expected a whole number from 1 to 4294967295"),
    ("connections", &["0"], "expected a whole number from 1 to 4294967295"),
    ("latency-threshold", &["-0.5"], "expected a number from 0 to inf"),
    ("percentile", &["100.1", "inf"], "expected a number from 0 to 100"),
    ("duration", &["10000001", "inf"], "expected a number from 0 to 10000000"),
    ("count", &["18446744073709551616"], "expected a whole number from 0 to 18446744073709551615"),
    ("retries", &["4294967296"], "expected a whole number from 0 to 4294967295"),
    ("verify", &["18446744073709551616"], "expected a whole number from 0 to 18446744073709551615"),
];
const RANGES: [Case; 2] = [
    (
        "concurrency-range",
        &["0", "3:1", "1:2:0", "1:inf", "1:2:3:4", "1:1e9:0.001"],
        "expected start:end:step",
    ),
    (
        "request-rate-range",
        &["0", "3:1", "1:2:0", "1:inf", "1:2:3:4", ":"],
        "numbers above 0, end at least start",
    ),
];
const OF_SERVE: [Case; 46] = [
    ("store", &[""], "expected a directory, file://PATH, memory://"),
    ("listen", &NO_ADDRESSES, "expected host:port with a port from 0 to 65535"),
    ("admin-listen", &NO_ADDRESSES, "expected host:port with a port from 0 to 65535"),
    ("otlp-endpoint", &NO_ADDRESSES, "expected http://HOST:PORT or https://HOST:PORT"),
    ("trusted-proxies", &NO_PROXIES, "expected an IP address"),
    (
        "log",
        &["", "verbose", "6", "hullcast", "info,loud", "h2=x"],
        "expected error, warn, info, debug, trace or off",
    ),
    ("log-format", &NO_NAMES, "[possible values: text, json]"),
    ("shares", &NO_NAMES, "[possible values: on, off]"),
    ("allow-plaintext", &NO_SWITCHES, "[possible values: true, false]"),
    ("playground", &NO_SWITCHES, "[possible values: true, false]"),
    ("grpc-web", &NO_SWITCHES, "[possible values: true, false]"),
    ("grpc-web-origins", &NO_ORIGINS, "expected http://HOST or https://HOST"),
    ("compute-threads", &["4097"], "expected a whole number from 0 to 4096"),
    ("grace-seconds", &["1e10", "inf"], "expected a number from 0 to 1000000000"),
    ("drain-seconds", &["1e10", "inf"], "expected a number from 0 to 1000000000"),
    ("max-connection-age-seconds", &["1e10"], "expected a number from 0 to 1000000000"),
    ("probe-seconds", &["0", "0.009"], "expected a number from 0.01 to 1000000000"),
    ("reload-seconds", &["0", "0.009"], "expected a number from 0.01 to 1000000000"),
    ("message-seconds", &["0", "0.0009"], "expected a number from 0.001 to 1000000000"),
    ("answer-seconds", &["0", "0.0009"], "expected a number from 0.001 to 1000000000"),
    ("otlp-share", &["1.1", "inf"], "expected a number from 0 to 1"),
    ("record-bytes", &["0", "1048575", "1025TiB", "1MB"], "expected 1 MiB to 1024 TiB (a number of bytes"),
    ("record-share", &["1.1", "inf"], "expected a number from 0 to 1"),
    ("record-slow-seconds", &["1e10", "inf"], "expected a number from 0 to 1000000000"),
    ("record-failed", &NO_SWITCHES, "[possible values: true, false]"),
    ("record-flagged", &NO_SWITCHES, "[possible values: true, false]"),
    ("max-message-bytes", &["1023", "2147483649", "3GiB"], "expected 1 KiB to 2 GiB (a number of bytes, or"),
    ("max-pairs-per-request", &["0", "4294967296"], "expected a whole number from 1 to 4294967295"),
    ("max-bodies-per-request", &["0", "4294967296"], "expected a whole number from 1 to 4294967295"),
    ("max-hulls-per-request", &["0", "4294967296"], "expected a whole number from 1 to 4294967295"),
    ("max-vertices-per-hull", &["3", "4294967296"], "expected a whole number from 4 to 4294967295"),
    ("max-points-per-hull", &["3", "4294967296"], "expected a whole number from 4 to 4294967295"),
    ("max-pairs-in-flight", &["0", "4294967296"], "expected a whole number from 1 to 4294967295"),
    ("max-deadline-seconds", &["0", "4294967296"], "expected a whole number from 1 to 4294967295"),
    ("max-connections", &["0", "4294967296"], "expected a whole number from 1 to 4294967295"),
    ("max-streams-per-connection", &["0"], "expected a whole number from 1 to 4294967295"),
    ("max-page-size", &["0", "4294967296"], "expected a whole number from 1 to 4294967295"),
    ("cache-age-seconds", &["4294967296"], "expected a whole number from 0 to 4294967295"),
    ("store-seconds", &["0", "3601"], "expected a whole number from 1 to 3600"),
    ("store-bytes", &["1125899906842625", "1MB"], "expected 0 bytes to 1024 TiB (a number of bytes"),
    ("max-stream-state-bytes", &["1025TiB"], "expected 0 bytes to 1024 TiB (a number of bytes"),
    ("max-request-bytes-in-flight", &["0", "0MiB"], "expected 1 byte to 1024 TiB (a number of bytes"),
    ("max-memory-bytes", &["0", "268435455", "255MiB", "101%", "1MB"], SIZE),
    ("cache-bytes", &["0", "1048577GiB", "-1%", "nan%", "inf%", "0%", "1  MiB"], SIZE),
    ("inject-pair-delay-us", &["18446744073709551616"], "expected a whole number from 0 to"),
    ("max-memory-bytes", &["10 %", "%", "MiB"], "expected 256 MiB to 1024 TiB"),
];
const OF_PRUNE: [Case; 1] = [(
    "older-than",
    &["d", "30", "1.5h", "30 d", "1w", "99999999999999999999d", "9999999999999999999d", "1d1h"],
    "expected a whole number of at least 0 and its unit, s, m, h or d, as in 30d",
)];
const OF_REPLAY: [Case; 1] = [("threads", &["4097"], "expected a whole number from 0 to 4096")];
const OF_REMOTE: [Case; 1] =
    [("remote", &NO_SERVERS, "expected host, host:port, unix:PATH, http://host:port or")];

/// Options whose values are names, files and folders: tests/cli.rs runs the binary with wrong ones.
const NAMES_AND_FILES: [(&str, &[&str]); 5] = [
    (
        "serve",
        &[
            "config",
            "tls-certificate",
            "tls-key",
            "tls-client-ca",
            "query-tokens",
            "register-tokens",
            "record",
        ],
    ),
    ("query", &["frame", "out", "tls-ca", "tls-certificate", "tls-key", "token-file"]),
    ("load", &["scene", "csv", "plot", "tls-ca", "tls-certificate", "tls-key", "token-file"]),
    ("prune", &["store"]),
    ("replay", &["tls-ca", "tls-certificate", "tls-key", "token-file"]),
];

/// The arguments that a subcommand requires.
fn needed(subcommand: &str) -> &'static [&'static str] {
    match subcommand {
        "query" => &["scene.json"],
        "replay" => &["records"],
        "prune" => &["--store", "s", "--older-than", "1d"],
        _ => &[],
    }
}

fn cases(subcommand: &str) -> Vec<Case> {
    match subcommand {
        "query" => [&OF_ANY_QUERY[..], &OF_REMOTE].concat(),
        "load" => [&OF_ANY_QUERY[..], &OF_LOAD, &RANGES, &OF_REMOTE].concat(),
        "serve" => OF_SERVE.to_vec(),
        "prune" => OF_PRUNE.to_vec(),
        "replay" => [&OF_REPLAY[..], &OF_REMOTE].concat(),
        other => panic!("{other} has no cases"),
    }
}

/// The wrong values of a case: those outside its range, and those of another type.
fn wrong_values(case: &Case) -> Vec<&'static str> {
    let (_, own, allowed) = *case;
    let mut values = own.to_vec();
    if allowed.contains("number") || allowed.contains("bytes") || allowed.contains("start:end") {
        values.extend(NO_NUMBERS);
    }
    if allowed.contains("whole number") || allowed.contains("number of bytes") {
        values.extend(NO_COUNTS);
    }
    values
}

fn command() -> Command {
    let mut command = complete(Arguments::command());
    command.build();
    command
}

fn refusal(subcommand: &str, words: &[&str]) -> String {
    // An option that is given twice would be another error.
    let given = |option: &str| words.iter().any(|word| word.starts_with(option));
    let needed = needed(subcommand).chunks(2).filter(|pair| !given(pair[0])).flatten().copied();
    let line = ["hullcast", subcommand].into_iter().chain(needed).chain(words.iter().copied());
    match command().try_get_matches_from(line) {
        Ok(_) => "accepted".into(),
        Err(error) => {
            assert_eq!(error.exit_code(), 2);
            error.to_string()
        }
    }
}

/// Catches an option that takes a wrong value, or refuses it without its name, the value or the
/// values that are allowed; and an option that is not in the tables.
#[test]
fn wrong_values_are_refused_by_option_value_and_range() {
    let (mut tried, mut faults) = (0, Vec::new());
    for (subcommand, files) in NAMES_AND_FILES {
        let mut seen: BTreeSet<String> = files.iter().map(|&name| name.to_owned()).collect();
        for case in cases(subcommand) {
            let (option, _, allowed) = case;
            for value in wrong_values(&case) {
                let said = refusal(subcommand, &[&format!("--{option}={value}")]);
                let names_all = said.contains(&format!("--{option}")) && said.contains(allowed);
                if !names_all || !shows(&said, value) {
                    faults.push(format!("--{option}={value:?}: {said}"));
                }
                tried += 1;
            }
            // A negative number may also follow the option as a separate word.
            if allowed.contains("number") {
                let said = refusal(subcommand, &[&format!("--{option}"), "-1"]);
                if !said.contains(&format!("'-1' for '--{option}")) || !said.contains(allowed) {
                    faults.push(format!("--{option} -1: {said}"));
                }
            }
            seen.insert(option.to_owned());
        }
        let command = command();
        let own = command.find_subcommand(subcommand).expect(subcommand);
        let options: BTreeSet<String> =
            own.get_arguments().filter(|arg| takes_values(arg)).filter_map(long).collect();
        assert_eq!(seen, options, "the options of {subcommand}");
        for switch in own.get_arguments().filter(|arg| matches!(arg.get_action(), ArgAction::SetTrue)) {
            let name = long(switch).expect("a switch has a name");
            let said = refusal(subcommand, &[&format!("--{name}=1")]);
            if !said.contains(&format!("'1' for '--{name}'")) {
                faults.push(format!("--{name}=1: {said}"));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(tried > 700, "{tried} values tried");
}

/// The same wrong values in a file, as texts and as bare values. Catches a value that is refused as a flag
/// and accepted from a file, or refused without the setting's name or what is allowed.
#[test]
fn wrong_values_of_a_file_are_refused_by_name_and_range() {
    let (mut tried, mut faults) = (0, Vec::new());
    for case in OF_SERVE {
        let (option, _, allowed) = case;
        let key = option.replace('-', "_");
        if !NAMES.contains(&key.as_str()) {
            continue;
        }
        for value in wrong_values(&case).into_iter().chain(allowed.contains("number").then_some("1e400")) {
            let quoted = toml::Value::String(value.into()).to_string();
            let bare = value.parse::<f64>().is_ok() && !value.starts_with(['0', '+']);
            for text in [Some(quoted), bare.then(|| value.to_owned())].into_iter().flatten() {
                match PartialSettings::parse(
                    &format!("log = \"info\"\n{key} = {text}\n").replace("log = \"info\"\nlog", "log"),
                ) {
                    Err(SettingsFileError::Text(said) | SettingsFileError::Value(said))
                        if said.contains(&key) && said.contains(allowed) => {}
                    other => faults.push(format!("{key} = {text}: {other:?}")),
                }
                tried += 1;
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
    assert!(tried > 500, "{tried} values tried");
}

/// Whether a message shows the value at fault; of a list, the part at fault.
fn shows(said: &str, value: &str) -> bool {
    let is_shown = |text: &str| said.contains(&format!("'{text}'"));
    is_shown(value)
        || value.split(',').any(is_shown)
        || (value.is_empty() && said.contains("but none was supplied"))
}

fn takes_values(arg: &Arg) -> bool {
    !arg.is_positional() && matches!(arg.get_action(), ArgAction::Set | ArgAction::Append)
}

fn long(arg: &Arg) -> Option<String> {
    arg.get_long().map(str::to_owned)
}

/// Catches an unknown option that is refused without a hint at the option that was probably meant.
#[test]
fn misspelt_options_and_commands_have_suggestions() {
    for (subcommand, option, meant) in [
        ("query", "--output", "--outputs"),
        ("query", "--remot", "--remote"),
        ("serve", "--lisen", "--listen"),
        ("load", "--conncurrency", "--concurrency"),
    ] {
        let said = refusal(subcommand, &[option]);
        assert!(said.contains(option) && said.contains(meant), "{said}");
    }
    let said = refusal("qeury", &[]);
    assert!(said.contains("'qeury'") && said.contains("'query'"), "{said}");
}

/// Catches an output or a solver that is accepted in only one spelling.
#[test]
fn names_are_known_in_either_spelling() {
    let line =
        |words: &[&str]| command().try_get_matches_from([&["hullcast", "query", "s.json"], words].concat());
    for outputs in ["witness-b", "WITNESS_B", "witness_b", "Witness-B", "ALPHA,witness_b,Diagnostics"] {
        assert!(line(&["--outputs", outputs]).is_ok(), "{outputs}");
    }
    for solver in ["gjk-ray-cast", "GJK_RAY_CAST", "gjk_ray_cast", "PORTAL"] {
        assert!(line(&["--solver", solver]).is_ok(), "{solver}");
    }
}
