//! Whole messages, as a newcomer reads them: each names what is wrong, what is allowed, and the option or the file
//! at fault.

use std::io::Write;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Stdio};

use super::{BINARY, Outcome, Server, hullcast, printed, scenes, scratch, text};

const GOOD: &str = r#"{"format": "hullcast.scene.v1", "name": "two", "margin": 0.5,
"hulls": [{"vertices": [[0,0,0],[1,0,0],[0,1,0],[0,0,1]]}],
"bodies": [{"hull": 0, "position": [0,0,0], "rotation": [0,0,0,1]},
           {"hull": 0, "position": [0,0,2], "rotation": [0,0,0,1]}],
"pairs": [[0,1]]}"#;

/// The exit code of a command, and the only line that it prints, without the name of the program.
fn said(command: &[&str]) -> Result<(Option<i32>, String), Box<dyn std::error::Error>> {
    let output = hullcast(command)?;
    let said = String::from_utf8(output.stderr)?;
    assert!(output.stdout.is_empty(), "{command:?}");
    let line = said.strip_prefix("hullcast: ").unwrap_or(&said).trim_end();
    assert_eq!(line.lines().count(), 1, "{said}");
    Ok((output.status.code(), line.to_owned()))
}

/// Catches a faulty value of a scene that is called by a type of Rust, or by a fault of JSON that the file does
/// not have, and a message that leaves out the file.
#[test]
fn a_fault_of_a_scene_has_file_place_value_and_range() -> Outcome {
    let folder = scratch("texts-scenes")?;
    let path = folder.join("scene.json");
    for (from, to, expected) in [
        (
            "[[0,1]]",
            "[[0,-1]]",
            "pairs[0][1]: invalid type: integer `-1`, expected an index, a whole number from 0 at line 5 column ",
        ),
        ("[[0,1]]", "[[0,1,1]]", "pairs[0]: invalid length 3, expected 2 indices at line 5 column "),
        ("[[0,1]]", "[[0,2]]", "pairs[0][1]: is 2, expected 0 to 1: the scene has 2 bodies"),
        ("{\"hull\": 0", "{\"hull\": 1", "bodies[0].hull: is 1, expected 0: the scene has 1 hull"),
        (
            "[0,0,1]]",
            "[0,0,1],[\"x\",0,0]]",
            "hulls[0].vertices[4][0]: invalid type: string \"x\", expected a number at line 2 column ",
        ),
        ("[0,0,1]]", "[1,1,0]]", "hulls[0].vertices: COPLANAR: "),
    ] {
        std::fs::write(&path, GOOD.replacen(from, to, 1))?;
        for (command, option) in [(&["query"][..], ""), (&["load", "--count", "1", "--scene"], "--scene ")] {
            let (code, said) = said(&[command, &[text(&path)]].concat())?;
            let expected = format!("{option}{}: {expected}", path.display());
            assert!(said.starts_with(&expected), "{said}\n{expected}");
            assert_eq!(code, Some(3));
        }
    }
    Ok(())
}

/// Catches a scene from the standard input that is read as a file of the name `-`, and a fault in it that does
/// not name its source.
#[test]
fn a_scene_may_come_from_the_standard_input() -> Outcome {
    let path = scratch("texts-piped")?.join("scene.json");
    std::fs::write(&path, GOOD)?;
    let from_file = printed(&["query", text(&path), "--json"])?;
    let piped = |scene: &str| -> Result<_, Box<dyn std::error::Error>> {
        let mut command = Command::new(BINARY);
        command.args(["query", "-", "--json"]).stdin(Stdio::piped());
        let mut process = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
        process.stdin.take().ok_or("no input")?.write_all(scene.as_bytes())?;
        Ok(process.wait_with_output()?)
    };
    assert_eq!(piped(GOOD)?.stdout, from_file);
    for (scene, expected) in [
        (
            "",
            "the standard input: not JSON (EOF while parsing a value at line 1 column 0); expected a scene file",
        ),
        (
            &*GOOD.replacen("[[0,1]]", "[[0,9]]", 1),
            "the standard input: pairs[0][1]: is 9, expected 0 to 1: ",
        ),
        (&*GOOD.replacen("[0,0,1]]", "[1,1,0]]", 1), "the standard input: hulls[0].vertices: COPLANAR: "),
    ] {
        let output = piped(scene)?;
        let said = String::from_utf8(output.stderr)?;
        assert!(said.starts_with(&format!("hullcast: {expected}")), "{said}");
        assert_eq!(output.status.code(), Some(3));
    }
    Ok(())
}

/// Catches `memory:`, a misspelt `memory://`, that becomes a directory, and messages about stores that do not
/// say what is expected.
#[test]
fn a_store_that_cannot_be_used_is_refused() -> Outcome {
    let folder = scratch("texts-stores")?;
    let file = folder.join("file");
    std::fs::write(&file, "x")?;
    let file = text(&file);
    let prune = |store: &str| said(&["prune", "--older-than", "1d", "--store", store]);
    for store in ["memory:", "memory:/", "s3:bucket", "file:x"] {
        let scheme = store.split(':').next().unwrap_or_default();
        let expected = format!(
            "--store {store}: a scheme ends with ://, expected {scheme}://; a directory of this name is ./{store}"
        );
        assert_eq!(
            said(&["serve", "--listen", "127.0.0.1:0", "--store", store])?,
            (Some(2), expected.clone())
        );
        assert_eq!(prune(store)?, (Some(2), expected));
        assert!(!Path::new(store).exists());
    }
    for (store, expected) in [
        (
            "memory://",
            "each process has its own memory, so this store is empty; expected the directory or the bucket that a server uses",
        ),
        (file, "no such directory"),
        (
            "ftp://x",
            "unknown scheme ftp://; a directory, file://, memory://, s3://, gs:// and az:// are known",
        ),
    ] {
        assert_eq!(prune(store)?, (Some(2), format!("--store {store}: {expected}")));
    }
    let (code, text) = said(&["serve", "--listen", "127.0.0.1:0", "--store", file])?;
    assert!(code == Some(2) && text.starts_with(&format!("--store {file}: ")), "{text}");
    Ok(())
}

/// Catches a wrong option that has the exit code of a failure or of faulty input.
#[test]
fn wrong_options_have_the_exit_code_of_usage() -> Outcome {
    let folder = scratch("texts-usage")?;
    let pem = folder.join("some.pem");
    std::fs::write(&pem, "")?;
    let rule =
        "is missing: TLS needs --tls-certificate and --tls-key, and --tls-client-ca works only with both";
    let expected = (Some(2), format!("--tls-key {rule}"));
    assert_eq!(said(&["serve", "--tls-certificate", text(&pem)])?, expected);
    let expected = (Some(2), format!("--tls-certificate {rule}"));
    assert_eq!(said(&["serve", "--tls-client-ca", text(&pem)])?, expected);
    if cfg!(not(feature = "otlp")) {
        let endpoint = "http://127.0.0.1:4317";
        let (code, text) = said(&["serve", "--store", "memory://", "--otlp-endpoint", endpoint])?;
        let built =
            "this server was built without traces: build it by `cargo build --release --features otlp`";
        assert_eq!((code, text), (Some(2), format!("--otlp-endpoint {endpoint}: {built}")));
    }
    Ok(())
}

/// Catches the picture that the TOML library draws of a fault, in place of a line that a log can hold.
#[test]
fn a_fault_of_the_settings_is_one_line() -> Outcome {
    let path = scratch("texts-config")?.join("settings.toml");
    for (content, expected) in [
        ("# Settings\nlisten = [\n", "line 2: "),
        ("log = \"info\"\nlog = \"warn\"\n", "line 2: duplicate key"),
        ("max_page_size 1000\n", "line 1: "),
        ("max_page_size = 1e\n", "line 1: max_page_size is \"1e\": expected a whole number from 1 to "),
        ("drain_seconds = -1\n", "drain_seconds is \"-1\": expected a number from 0 to 1000000000"),
    ] {
        std::fs::write(&path, content)?;
        let (code, said) = said(&["serve", "--config", text(&path)])?;
        assert!(said.starts_with(&format!("--config {}: {expected}", path.display())), "{content:?}: {said}");
        assert!(code == Some(3) || content.starts_with("drain"), "{said}");
    }
    Ok(())
}

/// Catches the name of a type of the TLS library in place of the file at fault.
#[test]
fn a_key_of_another_certificate_is_named() -> Outcome {
    let folder = scratch("texts-keys")?;
    let mut files = Vec::new();
    for name in ["own", "other"] {
        let made = rcgen::generate_simple_self_signed(["localhost".to_owned()])?;
        let [certificate, key] = ["certificate", "key"].map(|kind| folder.join(format!("{name}-{kind}.pem")));
        std::fs::write(&certificate, made.cert.pem())?;
        std::fs::write(&key, made.signing_key.serialize_pem())?;
        files.push([certificate, key]);
    }
    let (certificate, key) = (text(&files[0][0]), text(&files[1][1]));
    let expected = format!(
        "--tls-key {key}: it is not the key of the certificate {certificate}: give the key that belongs to it"
    );
    assert_eq!(said(&["serve", "--tls-certificate", certificate, "--tls-key", key])?, (Some(3), expected));
    Ok(())
}

/// Catches a refusal for a token that does not name the option by which a token is given.
#[test]
fn a_call_without_its_token_names_the_option() -> Outcome {
    let folder = scratch("texts-tokens")?;
    for name in ["known", "unknown"] {
        std::fs::write(folder.join(name), format!("{name}\n"))?;
    }
    let known = folder.join("known");
    let server = Server::start_with(&folder.join("store"), &["--query-tokens", text(&known)])?;
    let panda = scenes().join("panda.json");
    let query = ["query", text(&panda), "--remote", &server.address];
    let (code, without) = said(&query)?;
    assert!(
        without.contains("MISSING_TOKEN") && without.ends_with("give a file with a token by --token-file")
    );
    let unknown = folder.join("unknown");
    let (_, wrong) = said(&[&query[..], &["--token-file", text(&unknown)]].concat())?;
    assert!(
        wrong.contains("UNKNOWN_TOKEN") && wrong.ends_with("--token-file needs another token"),
        "{wrong}"
    );
    assert_eq!(code, Some(5));
    Ok(())
}

/// Catches a lost connection whose message does not say which server it was.
#[test]
fn a_peer_that_closes_the_connection_is_named() -> Outcome {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    let address = listener.local_addr()?.to_string();
    std::thread::spawn(move || listener.incoming().for_each(drop));
    let panda = scenes().join("panda.json");
    let (code, said) = said(&["query", text(&panda), "--remote", &address])?;
    assert!(said.contains(&address), "{said}");
    assert_eq!(code, Some(4));
    Ok(())
}

/// Catches a wrong port whose message does not have the allowed ones, and an address of another machine that is
/// not named.
#[test]
fn ports_and_addresses_are_refused_with_what_is_allowed() -> Outcome {
    let allowed = "expected host:port with a port from 0 to 65535 (0: any free one), or unix:PATH";
    for address in ["127.0.0.1:65536", "127.0.0.1:-1", "127.0.0.1", ":50051", "127.0.0.1:http"] {
        let output = hullcast(&["serve", "--store", "memory://", "--listen", address])?;
        let said = String::from_utf8(output.stderr)?;
        let expected = format!("error: invalid value '{address}' for '--listen <ADDR>': {allowed}");
        assert!(said.starts_with(&expected), "{said}");
        assert_eq!(output.status.code(), Some(2));
    }
    // An address that is kept for documents (RFC 5737), so that no machine has it.
    let elsewhere = ["serve", "--store", "memory://", "--listen", "192.0.2.1:0", "--allow-plaintext"];
    let (code, said) = said(&elsewhere)?;
    assert!(said.starts_with("--listen 192.0.2.1:0: ") && code == Some(2), "{said}");
    Ok(())
}
