//! Servers to which the system gives little.

use std::process::{Command, Output, Stdio};

use super::{BINARY, Outcome};

/// Runs `hullcast serve` under a limit of the shell's `ulimit`, until its input ends, which is at once.
fn served(limit: &str, arguments: &[&str]) -> Result<Output, std::io::Error> {
    let script = format!("ulimit {limit} && exec \"$@\"");
    let common = ["serve", "--listen", "127.0.0.1:0", "--store", "memory://", "--until-stdin-closes"];
    Command::new("sh")
        .args(["-c", &script, "sh", BINARY])
        .args(common)
        .args(arguments)
        .stdin(Stdio::null())
        .output()
}

/// Catches a server that starts with too few file descriptors and then fails strangely, one that refuses
/// without its numbers, and one that does not say how many connections it serves.
#[test]
fn too_few_open_files_are_refused_with_their_number() -> Outcome {
    for (files, arguments, parts) in [
        ("12", &[][..], "at least 41: 24 for the process, 1 for listen and 16 for connections"),
        ("40", &[], "at least 41: "),
        ("40", &["--max-connections", "20"], "max_connections is 20"),
        (
            "64",
            &["--admin-listen", "127.0.0.1:0"],
            "at least 106: 24 for the process, 1 for listen, 65 for admin_listen",
        ),
    ] {
        let output = served(&format!("-n {files}"), arguments)?;
        let said = String::from_utf8(output.stderr)?;
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.starts_with(&format!("hullcast: the system allows {files} open files")), "{said}");
        assert!(said.contains(parts) && said.contains("ulimit -n"), "{said}");
        assert_eq!((said.lines().count(), output.stdout.len()), (1, 0), "{said}");
    }
    let output = served("-n 41", &[])?;
    let said = String::from_utf8(output.stderr)?;
    assert!(output.status.success(), "{said}");
    assert!(said.contains("max_connections=10000") && said.contains("served=16"), "{said}");
    assert!(served("-n 40", &["--max-connections", "15"])?.status.success());
    Ok(())
}
