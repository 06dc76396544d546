//! Certificates and tokens, as docs/operations.md describes them.

use std::fmt::Write as _;
use std::process::Command;

use super::{Outcome, Server, hullcast, printed, scenes, scratch, text};

/// The commands of docs/operations.md that make a certificate.
fn openssl_lines() -> Result<String, Box<dyn std::error::Error>> {
    let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/docs/operations.md"))?;
    let block = page.split("```").find(|block| block.trim_start_matches("sh\n").starts_with("openssl "));
    Ok(block.ok_or("no block with openssl")?.trim_start_matches("sh\n").to_owned())
}

/// Makes a self-signed certificate with the commands of the page. Catches a command line that
/// does not accept it, or that accepts it although another certificate was given.
#[test]
fn a_certificate_that_openssl_made_works() -> Outcome {
    let folder = scratch("openssl")?;
    if Command::new("openssl").arg("version").output().is_err() {
        eprintln!("no openssl here: crates/client/src/trust.rs tests a certificate of the same kind");
        return Ok(());
    }
    let lines = openssl_lines()?;
    for name in ["own", "other"] {
        std::fs::create_dir(folder.join(name))?;
        let made = Command::new("sh").args(["-ec", &lines]).current_dir(folder.join(name)).output()?;
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    }
    let [certificate, key] = ["certificate.pem", "key.pem"].map(|name| folder.join("own").join(name));
    let arguments = ["--tls-certificate", text(&certificate), "--tls-key", text(&key)];
    let server = Server::start_with(&folder.join("store"), &arguments)?;
    let port = server.address.rsplit_once(':').ok_or("no port")?.1;
    let panda = scenes().join("panda.json");
    for host in ["localhost", "127.0.0.1"] {
        let remote = format!("https://{host}:{port}");
        printed(&["query", text(&panda), "--remote", &remote, "--tls-ca", text(&certificate)])?;
    }
    let remote = format!("https://localhost:{port}");
    let other = folder.join("other/certificate.pem");
    let output = hullcast(&["query", text(&panda), "--remote", &remote, "--tls-ca", text(&other)])?;
    let said = String::from_utf8(output.stderr)?;
    assert_eq!(output.status.code(), Some(4));
    assert!(said.contains("is self-signed") && said.contains("--tls-ca"), "{said}");
    Ok(())
}

/// Catches a certificate that is given and then ignored, so that poses and token are sent in plain text.
#[test]
fn a_certificate_asks_for_an_encrypted_connection() -> Outcome {
    let folder = scratch("plain")?;
    let server = Server::start_with(&folder.join("store"), &[])?;
    let panda = scenes().join("panda.json");
    for address in [server.address.clone(), format!("http://{}", server.address)] {
        let output = hullcast(&["query", text(&panda), "--remote", &address, "--tls-ca", text(&panda)])?;
        let said = String::from_utf8(output.stderr)?;
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(&format!("write https://{}", server.address)), "{said}");
    }
    Ok(())
}

/// The caller's token allows only queries. Catches a query that is refused although its hulls are
/// registered, and, if they are not, an error that does not say which token is needed.
#[test]
fn a_token_that_may_query_is_enough_for_hulls_that_are_there() -> Outcome {
    let folder = scratch("tokens")?;
    for name in ["reader", "writer"] {
        std::fs::write(folder.join(name), format!("{name}\n"))?;
    }
    let file = |name: &str| text(&folder.join(name)).to_owned();
    let (reader, writer) = (file("reader"), file("writer"));
    let lists = ["--query-tokens", &reader, "--register-tokens", &writer];
    let server = Server::start_with(&folder.join("store"), &lists)?;
    let panda = scenes().join("panda.json");
    for command in [&["query", text(&panda), "--json"][..], &["load", "--pairs", "8", "--count", "2"]] {
        let asked = |token: &str| {
            hullcast(&[command, &["--remote", &server.address, "--token-file", token]].concat())
        };
        let refused = asked(&reader)?;
        let mut said = String::new();
        write!(said, "{}", String::from_utf8_lossy(&refused.stderr))?;
        assert_eq!(refused.status.code(), Some(5), "{said}");
        assert!(
            said.contains("the token may not register them") && said.contains("--register-tokens"),
            "{said}"
        );
        assert!(said.contains("TOKEN_MAY_NOT") || said.contains("may query"), "{said}");
        let written = asked(&writer)?;
        assert!(written.status.success());
        let read = asked(&reader)?;
        assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
        if command[0] == "query" {
            assert_eq!(read.stdout, written.stdout);
        }
    }
    Ok(())
}
