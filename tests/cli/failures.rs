//! Options whose values are names, files and folders: the messages about wrong ones, and the exit codes.
//!
//! Values that are wrong by themselves are tested beside the options (`src/cli/refusals.rs`).

use std::path::Path;

use super::{Outcome, Server, hullcast, scenes, scratch, text};

/// Files with faults, and a path at which there is no file.
struct FaultyFiles {
    page: String,
    absent: String,
    nowhere: String,
    words: String,
    pem: String,
}

fn file(folder: &Path, name: &str, content: &str) -> Result<String, std::io::Error> {
    let path = folder.join(name);
    std::fs::write(&path, content)?;
    Ok(text(&path).to_owned())
}

impl FaultyFiles {
    fn write(folder: &Path) -> Result<Self, std::io::Error> {
        let pem = "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n";
        Ok(Self {
            page: file(folder, "page.md", "# A page\n")?,
            absent: text(&folder.join("absent")).to_owned(),
            nowhere: text(&folder.join("absent/file")).to_owned(),
            words: file(folder, "words", "two words\n")?,
            pem: file(folder, "faulty.pem", pem)?,
        })
    }
}

/// Runs a command that must fail with this exit code, print these texts, and print no answer.
fn refused(command: &[&str], exit: i32, texts: &[&str]) -> Outcome {
    let output = hullcast(command)?;
    let said = String::from_utf8(output.stderr)?;
    assert_eq!(output.status.code(), Some(exit), "{command:?}: {said}");
    for text in texts {
        assert!(said.contains(text), "{command:?}: {text:?} is not in {said}");
    }
    assert!(output.stdout.is_empty(), "{command:?}");
    Ok(())
}

/// Catches a faulty or missing scene or configuration for which the message does not name the option and
/// the expected value, or for which the exit code is wrong.
#[test]
fn wrong_scenes_are_refused_by_option_and_value() -> Outcome {
    let FaultyFiles { page, absent, nowhere, .. } = FaultyFiles::write(&scratch("files-scenes")?)?;
    let scene = scenes().join("panda.json");
    let scene = text(&scene);
    // The scene of a query, and of the other commands.
    refused(&["query", &page], 3, &[&page, "not JSON (", "expected a scene file, hullcast.scene.v1"])?;
    refused(&["query", &absent], 3, &[&absent, "cannot be read: No such file"])?;
    refused(&["load", "--scene", &page], 3, &["--scene", &page, "not JSON ("])?;
    refused(&["load", "--scene", &absent], 3, &["--scene", &absent, "cannot be read"])?;
    for (frame, hint) in
        [("grap", "did you mean `grasp`?"), ("6", "expected 0 to 5, or a name: home, "), ("-1", "0 to 5")]
    {
        refused(&["query", scene, "--frame", frame], 2, &[&format!("--frame {frame}: "), hint])?;
    }
    refused(&["query", scene, "--out", &nowhere], 1, &["--out", &nowhere, "No such file"])?;
    Ok(())
}

/// Catches a faulty certificate or token of a caller for which the message does not name the option.
#[test]
fn wrong_files_of_callers_are_refused_by_option_and_value() -> Outcome {
    let folder = scratch("files-callers")?;
    let FaultyFiles { absent, words, pem, .. } = FaultyFiles::write(&folder)?;
    let pipe = folder.join("pipe");
    rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::from_raw_mode(0o600))?;
    let pipe = text(&pipe).to_owned();
    let https = ["--remote", "https://localhost:1"];
    let few = ["--count", "1", "--pairs", "1"];
    let scene = scenes().join("panda.json");
    let scene = text(&scene);
    // Files about the server that is asked.
    for command in [&["query", scene][..], &[&["load"][..], &few].concat()] {
        let no_token = "the first line is the token: one or more visible ASCII characters";
        for (option, more, faulty) in [
            ("--tls-ca", &[][..], "not a PEM file"),
            ("--tls-certificate", &["--tls-key", &pem], "not a PEM file"),
            ("--tls-key", &["--tls-certificate", &pem], "not a PEM file"),
            ("--token-file", &[], no_token),
        ] {
            for (value, text) in [(&absent, "cannot be read: No such file"), (&words, faulty)] {
                let line = [command, &https, &[option, value], more].concat();
                refused(&line, 3, &[option, value, text])?;
            }
        }
        // Neither is waited for, nor read to its end.
        for option in ["--tls-ca", "--token-file"] {
            let line = [command, &https, &[option, &pipe]].concat();
            refused(&line, 3, &[option, &pipe, "is a pipe, must be a regular file of at most 1 MiB"])?;
            let line = [command, &https, &[option, "/dev/zero"]].concat();
            refused(&line, 3, &[option, "/dev/zero", "is a device, must be"])?;
        }
        let line = [command, &https, &["--tls-ca", &pem]].concat();
        refused(&line, 3, &["--tls-ca", &pem])?;
    }
    Ok(())
}

/// Catches results that cannot be written, if the message does not name the option.
#[test]
fn wrong_files_of_results_are_refused_by_option_and_value() -> Outcome {
    let FaultyFiles { nowhere, .. } = FaultyFiles::write(&scratch("files-results")?)?;
    let few = ["--count", "1", "--pairs", "1"];
    // Files for results.
    for option in ["--csv", "--plot"] {
        let output = hullcast(&[&["load", option, &nowhere][..], &few].concat())?;
        let said = String::from_utf8(output.stderr)?;
        assert!(said.contains(option) && said.contains(&nowhere), "{said}");
        assert_eq!(output.status.code(), Some(1));
    }
    Ok(())
}

/// Catches a faulty file or folder of a store or a server that the message does not name.
#[test]
fn wrong_files_of_servers_are_refused_by_option_and_value() -> Outcome {
    let folder = scratch("files-servers")?;
    let FaultyFiles { page, absent, pem, words, .. } = FaultyFiles::write(&folder)?;
    let empty = file(&folder, "empty", "# no token\n")?;
    let unknown = file(&folder, "unknown.toml", "listn = [\"localhost:1\"]\n")?;
    let syntax = file(&folder, "syntax.toml", "listen = [\n")?;
    let kind = file(&folder, "kind.toml", "drain_seconds = \"long\"\n")?;
    let range = file(&folder, "range.toml", "drain_seconds = -1\n")?;
    // Files of a server's settings.
    refused(&["serve", "--config", &absent], 3, &["--config", &absent, "cannot be read"])?;
    refused(&["serve", "--config", &unknown], 3, &["--config", &unknown, "`listn`; did you mean `listen`?"])?;
    refused(
        &["serve", "--config", &syntax],
        3,
        &[
            &format!("--config {syntax}: line 1: "),
            "\"listen = [\"; expected TOML, as in max_page_size = 1000",
        ],
    )?;
    let allowed = "expected a number from 0 to 1000000000";
    refused(&["serve", "--config", &kind], 2, &["--config", &kind, "drain_seconds is \"long\"", allowed])?;
    refused(&["serve", "--config", &range], 2, &["--config", &range, "drain_seconds is \"-1\"", allowed])?;
    let nothing = file(&folder, "nothing.toml", "listen = []\n")?;
    refused(
        &["serve", "--config", &nothing],
        2,
        &["--config", &nothing, "listen is [], must have at least one"],
    )?;
    for (value, expected) in
        [("ftp://x", "a directory, file://"), ("s3://bucket", "feature"), (&page, "store")]
    {
        refused(&["serve", "--store", value, "--listen", "127.0.0.1:0"], 2, &["--store", value, expected])?;
    }
    for (option, beside) in [("--tls-certificate", "--tls-key"), ("--tls-key", "--tls-certificate")] {
        let cannot = format!("{option} {absent}: cannot be read: No such file");
        refused(&["serve", option, &absent, beside, &pem], 3, &[&cannot])?;
        let rule =
            "is missing: TLS needs --tls-certificate and --tls-key, and --tls-client-ca works only with";
        refused(&["serve", option, &pem], 2, &[&format!("{beside} {rule}")])?;
    }
    for option in ["--query-tokens", "--register-tokens"] {
        refused(
            &["serve", option, &absent],
            3,
            &[&format!("{option} {absent}: cannot be read: No such file")],
        )?;
        refused(&["serve", option, &empty], 3, &[&format!("{option} {empty}: no token in it")])?;
        let space =
            "line 1: the token has a space, which no client can send: use visible ASCII characters only";
        refused(&["serve", option, &words], 3, &[&format!("{option} {words}: {space}")])?;
    }
    let tls = ["--tls-certificate", &pem, "--tls-key", &pem];
    refused(&[&["serve", "--tls-client-ca", &absent], &tls[..]].concat(), 3, &["--tls-client-ca", &absent])?;
    refused(&[&["serve"], &tls[..]].concat(), 3, &["--tls-key", &pem, "no private key (PEM) in it"])?;
    let both = ["serve", "--listen", "127.0.0.1:7", "--admin-listen", "127.0.0.1:7"];
    refused(&both, 2, &["--admin-listen is 127.0.0.1:7, which contradicts --listen 127.0.0.1:7"])?;
    // `--print-config` refuses the settings that a start refuses.
    let least = ["--max-memory-bytes", "256MiB", "--max-message-bytes", "16MiB"];
    let printed = [&["serve", "--print-config"], &least[..]].concat();
    for line in [&printed[..], &[&["serve", "--store", "memory://"], &least[..]].concat()] {
        let numbers =
            ["--max-message-bytes (16 MiB)", "--max-points-per-hull (262144)", "twice the largest request"];
        refused(line, 2, &[&["--max-memory-bytes is 256 MiB, must be at least "], &numbers[..]].concat())?;
    }
    refused(&["serve", "--print-config", "--query-tokens", &absent], 3, &["--query-tokens", &absent])?;
    let contradiction = ["serve", "--max-pairs-in-flight", "5", "--store", "memory://"];
    refused(
        &contradiction,
        2,
        &["--max-pairs-in-flight is 5, must be at least 131072 (--max-pairs-per-request)"],
    )?;
    refused(
        &["prune", "--store", &absent, "--older-than", "1d"],
        2,
        &["--store", &absent, "no such directory"],
    )?;
    Ok(())
}

/// Catches an address that is in use, or that other machines can reach without TLS, if the message does
/// not name it and a remedy.
#[test]
fn addresses_that_cannot_be_served_are_named() -> Outcome {
    let folder = scratch("bound")?;
    let server = Server::start(&folder.join("store"))?;
    let store = ["--store", "memory://"];
    let refused = |arguments: &[&str]| -> Result<String, Box<dyn std::error::Error>> {
        let output = hullcast(&[&["serve"], arguments, &store].concat())?;
        assert_eq!(output.status.code(), Some(2));
        Ok(String::from_utf8(output.stderr)?)
    };
    let said = refused(&["--listen", &server.address])?;
    assert!(said.contains(&format!("--listen {}: ", server.address)), "{said}");
    assert!(said.contains("another server has it: stop that one, or choose another port"), "{said}");
    let said = refused(&["--listen", "127.0.0.1:0", "--admin-listen", &server.address])?;
    assert!(said.contains(&format!("--admin-listen {}: ", server.address)), "{said}");
    let file = folder.join("file");
    std::fs::write(&file, "content")?;
    let said = refused(&["--listen", &format!("unix:{}", file.display())])?;
    assert!(said.contains("something else than a socket: choose another path"), "{said}");
    assert_eq!(std::fs::read_to_string(&file)?, "content");
    let socket = format!("unix:{}", folder.join("socket").display());
    let _held = std::os::unix::net::UnixListener::bind(folder.join("socket"))?;
    let said = refused(&["--listen", &socket])?;
    assert!(said.contains("another server has it: stop that one, or choose another path"), "{said}");
    let said = refused(&["--listen", "0.0.0.0:0"])?;
    assert!(said.contains("--listen 0.0.0.0:0: ") && said.contains("--allow-plaintext"), "{said}");
    Ok(())
}

/// Catches a usage error with another exit code, and exit codes that the help does not list.
#[test]
fn the_help_lists_the_exit_codes() -> Outcome {
    assert_eq!(hullcast(&["query"])?.status.code(), Some(2));
    assert_eq!(hullcast(&["query", "x", "--no-such-option"])?.status.code(), Some(2));
    let help = String::from_utf8(hullcast(&["--help"])?.stdout)?;
    for code in ["0  success", "1  ", "2  ", "3  ", "4  ", "5  ", "6  "] {
        assert!(help.contains(&format!("\n  {code}")), "{code}: {help}");
    }
    Ok(())
}

/// Catches a shell without a completion script, and a script that does not contain the options.
#[test]
fn every_shell_has_completions() -> Outcome {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let output = hullcast(&["completions", shell])?;
        let script = String::from_utf8(output.stdout)?;
        assert_eq!(output.status.code(), Some(0));
        // For two of the shells, the scripts do not complete values.
        let value = if ["bash", "zsh", "fish"].contains(&shell) { "witness-b" } else { "outputs" };
        for word in ["relative-tolerance", value, "older-than", "completions"] {
            assert!(script.contains(word), "{shell} lacks {word}");
        }
    }
    let said = String::from_utf8(hullcast(&["completions", "cmd"])?.stderr)?;
    assert!(said.contains("'cmd' for '<SHELL>'") && said.contains("bash"), "{said}");
    Ok(())
}
