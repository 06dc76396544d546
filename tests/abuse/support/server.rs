//! The server under attack: the real binary, observed from outside.

use std::{
    fs::File,
    io::{BufRead, BufReader},
    net::SocketAddr,
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
};

use rcgen::{CertificateParams, KeyPair};
use tempfile::TempDir;
use tokio::io::{AsyncReadExt, AsyncWriteExt};

use super::{dial, setup::Setup};

/// The tokens of the server's two lists.
pub(crate) const QUERY_TOKEN: &str = "may-query";
pub(crate) const REGISTER_TOKEN: &str = "may-register";

/// The address from which the tests read the metrics.
const OBSERVER: &str = "127.0.0.9";

/// `hullcast serve`; killed when dropped.
pub(crate) struct Server {
    child: Child,
    pub(crate) address: SocketAddr,
    pub(crate) admin: SocketAddr,
    /// The Unix socket on which the server also listens.
    pub(crate) socket: PathBuf,
    /// The certificate that clients have to trust, or `None` if TCP is not encrypted.
    pub(crate) certificate: Option<String>,
    directory: TempDir,
}

impl Server {
    /// Starts the server and waits until it listens.
    pub(crate) fn start(setup: &Setup) -> Self {
        let directory = tempfile::tempdir().expect("a directory");
        let path = |name: &str| directory.path().join(name);
        std::fs::create_dir(path("store")).expect("a store");
        if let Some(fill) = setup.fill_store {
            fill(&path("store"));
        }
        let mut flags = setup.flags();
        if setup.tokens {
            flags.extend(tokens(directory.path()));
        }
        let mut certificate = None;
        if setup.tls {
            let (flags_of_tls, pem) = encryption(directory.path());
            flags.extend(flags_of_tls);
            certificate = Some(pem);
        }
        if cfg!(feature = "playground") {
            flags.push("--playground=true".into());
        }
        let binary = std::env::var("HULLCAST_ABUSE_BIN");
        let binary = binary.unwrap_or_else(|_| env!("CARGO_BIN_EXE_hullcast").into());
        let limit = setup.ulimit.as_ref().map_or(String::new(), |limit| format!("ulimit {limit} && "));
        let mut child = Command::new("sh")
            .args(["-c", &format!("{limit}exec \"$0\" \"$@\""), &binary, "serve"])
            .args(["--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0"])
            .arg(format!("--listen=unix:{}", path("socket").display()))
            .arg(format!("--store={}", path("store").display()))
            .args(flags)
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(File::create(path("log")).expect("a log"))
            .spawn()
            .expect("a shell");
        let mut lines = BufReader::new(child.stdout.take().expect("its output")).lines();
        let mut next = |beginning: &str| {
            let line = lines.next().and_then(Result::ok);
            line.and_then(|line| Some(line.strip_prefix(beginning)?.to_owned())).unwrap_or_else(|| {
                panic!(
                    "the server does not start: {}",
                    std::fs::read_to_string(path("log")).unwrap_or_default()
                )
            })
        };
        let address = next("listening on ").parse().expect("an address");
        next("listening on unix:");
        let admin = next("admin on ").parse().expect("an address");
        Self { child, address, admin, socket: path("socket"), certificate, directory }
    }

    pub(crate) fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Sends SIGTERM to the server.
    pub(crate) fn terminate(&self) {
        let status = Command::new("kill").args(["-TERM", &self.pid().to_string()]).status();
        assert!(status.expect("kill").success());
    }

    /// Waits until the server's process has ended.
    pub(crate) async fn ended(&mut self) -> ExitStatus {
        loop {
            if let Some(status) = self.child.try_wait().expect("its status") {
                return status;
            }
            tokio::time::sleep(std::time::Duration::from_millis(5)).await;
        }
    }

    /// The directory of the store.
    pub(crate) fn store(&self) -> PathBuf {
        self.directory.path().join("store")
    }

    /// The server's whole log.
    pub(crate) fn log(&self) -> String {
        let bytes = std::fs::read(self.directory.path().join("log")).unwrap_or_default();
        String::from_utf8_lossy(&bytes).into_owned()
    }

    /// The text of /metrics. The request is repeated while the admin port is too busy.
    pub(crate) async fn metrics(&self) -> String {
        loop {
            if let Ok(text) = get(self.admin, "/metrics").await
                && let Some((_, body)) = text.split_once("\r\n\r\n")
            {
                return body.to_owned();
            }
            tokio::time::sleep(std::time::Duration::from_millis(100)).await;
        }
    }

    /// The value of one metric, or `None` if the server does not have it.
    pub(crate) async fn metric(&self, name: &str) -> Option<f64> {
        value(&self.metrics().await, name)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The value of the line of metrics that begins with `name` and a space.
pub(crate) fn value(metrics: &str, name: &str) -> Option<f64> {
    metrics.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' ')?.parse().ok())
}

/// A field of /proc/PID/status in bytes, for example `VmRSS`; 0 if the process has ended.
pub(crate) fn status_bytes(pid: u32, field: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(field)?.strip_prefix(':'));
    let kib = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok());
    kib.unwrap_or(0) << 10
}

async fn get(admin: SocketAddr, path: &str) -> std::io::Result<String> {
    let mut stream = dial::tcp(OBSERVER, admin).await?;
    let request = format!("GET {path} HTTP/1.1\r\nhost: here\r\nconnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await?;
    let mut text = String::new();
    stream.read_to_string(&mut text).await?;
    Ok(text)
}

fn tokens(directory: &Path) -> Vec<String> {
    let list = |name: &str, text: &str| {
        let path = directory.join(name);
        std::fs::write(&path, text).expect("a list of tokens");
        path.display().to_string()
    };
    let query = list("query-tokens", QUERY_TOKEN);
    let register = list("register-tokens", REGISTER_TOKEN);
    vec![format!("--query-tokens={query}"), format!("--register-tokens={register}")]
}

/// Writes a self-signed certificate, and returns the server's flags for it and the certificate.
fn encryption(directory: &Path) -> (Vec<String>, String) {
    let key = KeyPair::generate().expect("a key");
    let params = CertificateParams::new(["localhost".to_owned()]).expect("a name");
    let certificate = params.self_signed(&key).expect("a certificate").pem();
    let write = |name: &str, text: &str| {
        let path = directory.join(name);
        std::fs::write(&path, text).expect("a file");
        path.display().to_string()
    };
    let (at, key_at) = (write("certificate.pem", &certificate), write("key.pem", &key.serialize_pem()));
    (vec![format!("--tls-certificate={at}"), format!("--tls-key={key_at}")], certificate)
}
