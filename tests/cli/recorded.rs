//! Records of calls, and their replay, with the real program and real files.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use super::{BINARY, Outcome, Server, hullcast, scenes, scratch, text};

/// The time within which a server under load has written 1 MiB of records, on a slow and busy machine too.
const WRITTEN_WITHIN: Duration = Duration::from_secs(15);

/// The files of records in a folder, in order.
fn records(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut files: Vec<PathBuf> = fs::read_dir(folder)?.flatten().map(|file| file.path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "hullrec"));
    files.sort();
    Ok(files)
}

/// Sends batches, and the scene of the example, to a server that records every call into `folder`.
fn record(name: &str, arguments: &[&str]) -> Result<PathBuf, Box<dyn std::error::Error>> {
    let folder = scratch(name)?;
    let directory = folder.join("records");
    let mut all = vec!["--record", text(&directory), "--record-share", "1"];
    all.extend(arguments);
    let mut server = Server::start_with(&folder.join("store"), &all)?;
    send(&server.address)?;
    drop(server.process.stdin.take());
    assert!(server.process.wait()?.success());
    Ok(directory)
}

fn send(address: &str) -> Outcome {
    let load = [
        "load",
        "--remote",
        address,
        "--batches",
        "2",
        "--pairs",
        "32",
        "--count",
        "20",
        "--concurrency",
        "2",
    ];
    let sent = hullcast(&load)?;
    assert!(sent.status.success(), "{}", String::from_utf8_lossy(&sent.stderr));
    let panda = scenes().join("panda.json");
    let answered = hullcast(&["query", text(&panda), "--remote", address])?;
    assert!(answered.status.success(), "{}", String::from_utf8_lossy(&answered.stderr));
    Ok(())
}

/// The exit code of a replay, its output and its messages.
fn replay(arguments: &[&str]) -> Result<(Option<i32>, String, String), Box<dyn std::error::Error>> {
    let output = hullcast(&[&["replay"], arguments].concat())?;
    let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
    Ok((output.status.code(), text(output.stdout), text(output.stderr)))
}

/// Catches a record that lacks a hull or a byte of the request, or whose digests are not those of the answer: it could
/// not be computed again elsewhere. Catches an answer that depends on the number of threads.
#[test]
fn records_reproduce_their_calls_anywhere() -> Outcome {
    let directory = record("recorded", &["--compute-threads", "2"])?;
    let directory = text(&directory);
    for threads in ["1", "3"] {
        let (code, printed, said) = replay(&[directory, "--threads", threads])?;
        assert_eq!(code, Some(0), "{printed}{said}");
        let calls: u64 = printed.split(' ').next().ok_or("no count")?.parse()?;
        assert!(calls > 20 && printed.contains(": 0 differ"), "{printed}");
    }
    let other = Server::start(&scratch("recorded-elsewhere")?.join("store"))?;
    let (code, printed, said) = replay(&[directory, "--remote", &other.address])?;
    assert_eq!(code, Some(0), "{printed}{said}");
    Ok(())
}

/// Catches a server that writes records although it was not asked to.
#[test]
fn nothing_is_recorded_unasked() -> Outcome {
    let folder = scratch("unrecorded")?;
    let server = Server::start_with(&folder.join("store"), &["--record-share", "1"])?;
    send(&server.address)?;
    drop(server);
    let files: Vec<_> = fs::read_dir(&folder)?.flatten().map(|file| file.file_name()).collect();
    assert_eq!(files, ["store"]);
    Ok(())
}

/// Catches a header of a call that gets into its record: there is no place for one, so a token cannot be there.
#[test]
fn a_record_has_no_token() -> Outcome {
    use hullcast::record::{Content, Entries};
    let folder = scratch("recorded-token")?;
    let (directory, tokens, token) =
        (folder.join("records"), folder.join("tokens"), "a-secret-of-one-caller");
    fs::write(&tokens, format!("{token}\n"))?;
    let arguments = ["--record", text(&directory), "--record-share", "1", "--register-tokens", text(&tokens)];
    let mut server = Server::start_with(&folder.join("store"), &arguments)?;
    let panda = scenes().join("panda.json");
    let remote = ["query", text(&panda), "--remote", &server.address, "--token-file", text(&tokens)];
    assert!(hullcast(&remote)?.status.success());
    drop(server.process.stdin.take());
    assert!(server.process.wait()?.success());
    let mut calls = 0;
    for entry in Entries::open(&records(&directory)?.remove(0))? {
        let shown = match entry? {
            Content::Call(call) => {
                calls += 1;
                [call.method.as_bytes(), &call.request, &call.digests].concat()
            }
            Content::Hull(hull) => hull.to_vec(),
            Content::Header(header) => format!("{header:?}").into_bytes(),
        };
        assert!(!shown.windows(token.len()).any(|window| window == token.as_bytes()));
    }
    assert!(calls > 0);
    Ok(())
}

/// Catches damage that costs more than its file, or that is not named with file and place, and a cut file that counts
/// as damaged.
#[test]
fn damage_is_named_and_costs_only_itself() -> Outcome {
    use hullcast::record::{Content, Entries};
    let directory = record("recorded-otherwise", &[])?;
    let file = records(&directory)?.remove(0);
    let whole = fs::read(&file)?;
    let calls = Entries::open(&file)?.filter(|entry| matches!(entry, Ok(Content::Call(_)))).count();
    // Damage in the last entry is named with file and offset, and the calls before it are still replayed.
    let mut damaged = whole.clone();
    let at = damaged.len() - 3;
    damaged[at] ^= 1;
    fs::write(&file, &damaged)?;
    let (code, printed, said) = replay(&[text(&directory)])?;
    assert_eq!(code, Some(3), "{printed}{said}");
    assert!(
        said.contains(&format!("{}: at byte ", file.display())) && said.contains("do not match"),
        "{said}"
    );
    assert!(printed.starts_with(&format!("{} calls", calls - 1)), "{printed}");
    // A cut file is no error.
    fs::write(&file, &whole[..at])?;
    let (code, printed, said) = replay(&[text(&directory)])?;
    assert_eq!(code, Some(0), "{printed}{said}");
    assert!(
        said.contains("the file ends after") && printed.starts_with(&format!("{} calls", calls - 1)),
        "{said}"
    );
    Ok(())
}

/// Catches a server whose records cannot be read after it was killed while it wrote.
#[test]
fn records_of_a_killed_server_are_whole() -> Outcome {
    let folder = scratch("recorded-killed")?;
    let directory = folder.join("records");
    let arguments = ["--record", text(&directory), "--record-share", "1"];
    let mut server = Server::start_with(&folder.join("store"), &arguments)?;
    let load =
        ["load", "--remote", &server.address, "--pairs", "256", "--duration", "20", "--concurrency", "4"];
    let mut load = Command::new(BINARY).args(load).stdout(Stdio::null()).stderr(Stdio::null()).spawn()?;
    let begun = Instant::now();
    let written = || -> std::io::Result<u64> {
        Ok(records(&directory)?.first().map_or(0, |file| fs::metadata(file).map_or(0, |file| file.len())))
    };
    while written()? < 1 << 20 {
        assert!(begun.elapsed() < WRITTEN_WITHIN, "{} bytes of records after {WRITTEN_WITHIN:?}", written()?);
        sleep(Duration::from_millis(5));
    }
    server.process.kill()?;
    server.process.wait()?;
    load.kill()?;
    load.wait()?;
    let (code, printed, said) = replay(&[text(&directory)])?;
    assert_eq!(code, Some(0), "{printed}{said}");
    assert!(!printed.starts_with("0 calls"), "{printed}");
    Ok(())
}

/// Catches a call that fails or waits because its record cannot be written. `ulimit -f` lets the server write files of
/// 64 KiB at most, as a full disk would.
#[test]
fn a_full_disk_costs_records_and_no_calls() -> Outcome {
    let folder = scratch("recorded-full")?;
    let directory = folder.join("records");
    let script = "trap '' XFSZ; ulimit -f 64; exec \"$0\" \"$@\"";
    let mut process = Command::new("bash")
        .args(["-c", script, BINARY, "serve", "--listen", "127.0.0.1:0", "--store", "memory://"])
        .args(["--record", text(&directory), "--record-share", "1", "--until-stdin-closes"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()?;
    let mut line = String::new();
    std::io::BufRead::read_line(
        &mut std::io::BufReader::new(process.stdout.take().ok_or("no output")?),
        &mut line,
    )?;
    let address = line.trim().strip_prefix("listening on ").ok_or("not listening")?.to_owned();
    let load = ["load", "--remote", &address, "--pairs", "2048", "--count", "60", "--concurrency", "2"];
    let sent = hullcast(&load)?;
    drop(process.stdin.take());
    let mut log = String::new();
    std::io::Read::read_to_string(&mut process.stderr.take().ok_or("no log")?, &mut log)?;
    assert!(process.wait()?.success());
    assert!(sent.status.success(), "{}", String::from_utf8_lossy(&sent.stderr));
    assert!(log.contains("a record could not be written"), "{log}");
    let files = records(&directory)?;
    assert_eq!(files.len(), 1, "{files:?}");
    let (code, printed, said) = replay(&[text(&directory)])?;
    assert_eq!(code, Some(0), "{printed}{said}");
    Ok(())
}

/// Catches a directory that grows beyond its limit, and a file that lacks the hulls of its first call because another
/// file has them.
#[test]
fn the_directory_is_bounded() -> Outcome {
    let folder = scratch("recorded-bounded")?;
    let directory = folder.join("records");
    let arguments = ["--record", text(&directory), "--record-share", "1", "--record-bytes", "1MiB"];
    let mut server = Server::start_with(&folder.join("store"), &arguments)?;
    let load =
        ["load", "--remote", &server.address, "--pairs", "512", "--count", "200", "--concurrency", "2"];
    let sent = hullcast(&load)?;
    assert!(sent.status.success(), "{}", String::from_utf8_lossy(&sent.stderr));
    drop(server.process.stdin.take());
    assert!(server.process.wait()?.success());
    let files = records(&directory)?;
    let bytes: u64 = files.iter().map(|file| fs::metadata(file).map_or(0, |file| file.len())).sum();
    assert!(files.len() > 1 && bytes > 400 << 10 && bytes <= 1 << 20, "{} files, {bytes} bytes", files.len());
    for file in &files {
        let (code, printed, said) = replay(&[text(file)])?;
        assert_eq!(code, Some(0), "{printed}{said}");
    }
    Ok(())
}
