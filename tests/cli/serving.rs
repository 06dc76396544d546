//! The lines that a server prints when it starts, and its log.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use super::{BINARY, Outcome, hullcast, scenes, scratch, text};

/// Starts a server in `folder`; its output ends when it is stopped.
fn start(folder: &Path, arguments: &[&str]) -> Result<Child, std::io::Error> {
    Command::new(BINARY)
        .args(["serve", "--listen", "127.0.0.1:0", "--until-stdin-closes"])
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
}

/// Catches a default store whose directory the server does not print, a playground that is served
/// without the flag, and a playground whose address the server does not print.
#[test]
fn the_default_store_and_the_playground_are_announced() -> Outcome {
    let folder = scratch("announced")?;
    let announced = |arguments: &[&str]| -> Result<Vec<String>, Box<dyn std::error::Error>> {
        let mut server = start(&folder, arguments)?;
        let mut output = BufReader::new(server.stdout.take().ok_or("no output")?);
        let mut text = String::new();
        output.read_line(&mut text)?;
        drop(server.stdin.take());
        output.read_to_string(&mut text)?;
        assert!(server.wait()?.success());
        Ok(text.lines().map(str::to_owned).collect())
    };
    let lines = announced(&[])?;
    let [listening, kept] = &lines[..] else { return Err(format!("{lines:?}").into()) };
    assert!(listening.starts_with("listening on 127.0.0.1:"));
    let store = folder.join("hullcast-store");
    assert_eq!(*kept, format!("hulls are kept in {} (the default of --store)", store.display()));
    assert!(store.is_dir());
    assert_eq!(announced(&["--store", "memory://"])?.len(), 1);
    if cfg!(feature = "playground") {
        let lines = announced(&["--store", "memory://", "--playground", "--admin-listen", "127.0.0.1:0"])?;
        let [listening, admin, page] = &lines[..] else { return Err(format!("{lines:?}").into()) };
        let address = listening.strip_prefix("listening on ").ok_or("not listening")?;
        assert!(admin.starts_with("admin on "), "{admin}");
        assert_eq!(*page, format!("playground at http://{address}/"));
        let everywhere = ["--allow-plaintext", "--listen", "0.0.0.0:0"];
        let lines = announced(&[&["--store", "memory://", "--playground"], &everywhere[..]].concat())?;
        assert!(lines.iter().filter(|line| line.starts_with("playground at http://127.0.0.1:")).count() == 2);
    }
    Ok(())
}

/// Catches a log of calls that also has a line for each HTTP/2 frame, and frames that cannot be
/// logged at all.
#[test]
fn the_debug_log_is_about_calls() -> Outcome {
    let folder = scratch("log")?;
    let panda = scenes().join("panda.json");
    let logged = |level: &str| -> Result<Vec<String>, Box<dyn std::error::Error>> {
        let mut server = start(&folder, &["--store", "memory://", "--log", level])?;
        let mut output = BufReader::new(server.stdout.take().ok_or("no output")?);
        let mut line = String::new();
        output.read_line(&mut line)?;
        let address = line.trim().strip_prefix("listening on ").ok_or("not listening")?;
        let answered = hullcast(&["query", text(&panda), "--remote", address])?;
        drop(server.stdin.take());
        let mut log = String::new();
        server.stderr.take().ok_or("no log")?.read_to_string(&mut log)?;
        assert!(server.wait()?.success() && answered.status.success());
        Ok(log.lines().map(str::to_owned).collect())
    };
    for level in ["debug", "trace"] {
        let lines = logged(level)?;
        let own = lines.iter().filter(|line| line.contains(" hullcast::")).count();
        assert!(lines.iter().any(|line| line.contains("QueryContacts")), "{lines:?}");
        assert!(2 * own > lines.len(), "{own} of {} lines are hullcast's: {lines:#?}", lines.len());
        assert!(!lines.iter().any(|line| line.contains(" h2::") || line.contains(" hyper::")), "{lines:#?}");
    }
    assert!(logged("info,h2=debug")?.iter().any(|line| line.contains(" h2::")));
    Ok(())
}

/// Catches a second signal that waits for the end of the grace period, or that ends the process before the
/// log is written.
#[test]
fn a_server_that_is_told_to_stop_again_ends_at_once() -> Outcome {
    let mut server = start(&scratch("again")?, &["--store", "memory://", "--grace-seconds", "600"])?;
    let mut line = String::new();
    BufReader::new(server.stdout.take().ok_or("no output")?).read_line(&mut line)?;
    let process = server.id().to_string();
    let mut log = BufReader::new(server.stderr.take().ok_or("no log")?).lines();
    let stop = || Command::new("kill").args(["-TERM", &process]).status();
    stop()?;
    let mut wait_for = |words: &str| log.by_ref().map_while(Result::ok).any(|line| line.contains(words));
    assert!(wait_for("stopping grace_seconds=600"));
    stop()?;
    assert!(wait_for("told to stop again: ending at once"));
    assert_eq!(server.wait()?.code(), Some(1));
    Ok(())
}
