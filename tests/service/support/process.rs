//! Runs the real binary as a process, and builds the tracer that is preloaded into it.

use std::{
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, ChildStdin, Command, ExitStatus, Stdio},
    time::Duration,
};

use hullcast::proto::{contact_service_client::ContactServiceClient, hull_service_client::HullServiceClient};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tonic::transport::Channel;

pub(crate) const BINARY: &str = env!("CARGO_BIN_EXE_hullcast");

/// A running `hullcast serve`, killed when dropped.
pub(crate) struct Process {
    pub(crate) child: Child,
    pub(crate) stdin: Option<ChildStdin>,
    pub(crate) address: String,
    /// The address of /readyz, if the arguments asked for an admin port.
    pub(crate) admin: Option<String>,
}

impl Process {
    pub(crate) fn start(command: Command, store: &Path, arguments: &[&str]) -> Self {
        Self::try_start(command, store, arguments).expect("it listens")
    }

    /// None if the process ended before it listened.
    pub(crate) fn try_start(command: Command, store: &Path, arguments: &[&str]) -> Option<Self> {
        Self::spawn(command, store, arguments, Stdio::null())
    }

    /// A server whose log lines go to a file.
    pub(crate) fn logging(store: &Path, arguments: &[&str], log: &Path) -> Self {
        let log = std::fs::File::create(log).unwrap();
        Self::spawn(Command::new(BINARY), store, arguments, log.into()).expect("it listens")
    }

    fn spawn(mut command: Command, store: &Path, arguments: &[&str], log: Stdio) -> Option<Self> {
        let mut child = command
            .args(["serve", "--listen", "127.0.0.1:0", "--store"])
            .arg(store)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .unwrap_or_else(|error| panic!("{command:?}: {error}"));
        let stdin = child.stdin.take();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let Some(Ok(line)) = lines.next() else {
            child.wait().unwrap();
            return None;
        };
        let address = line.strip_prefix("listening on ").expect(&line).to_owned();
        let admin = arguments.contains(&"--admin-listen").then(|| {
            let line = lines.next().unwrap().unwrap();
            line.strip_prefix("admin on ").expect(&line).to_owned()
        });
        Some(Self { child, stdin, address, admin })
    }

    pub(crate) fn plain(store: &Path) -> Self {
        Self::start(Command::new(BINARY), store, &[])
    }

    pub(crate) async fn hulls(&self) -> HullServiceClient<Channel> {
        HullServiceClient::new(channel(&self.address).await)
    }

    pub(crate) async fn contacts(&self) -> ContactServiceClient<Channel> {
        ContactServiceClient::new(channel(&self.address).await)
    }

    /// The body of a GET on the admin port.
    pub(crate) async fn get(&self, path: &str) -> String {
        let mut stream = tokio::net::TcpStream::connect(self.admin.as_ref().unwrap()).await.unwrap();
        let request = format!("GET {path} HTTP/1.1\r\nhost: here\r\nconnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut text = String::new();
        stream.read_to_string(&mut text).await.unwrap();
        text.split_once("\r\n\r\n").unwrap().1.to_owned()
    }

    /// Waits until the body of /readyz starts with `beginning`.
    pub(crate) async fn until_ready_says(&self, beginning: &str) {
        while !self.get("/readyz").await.starts_with(beginning) {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    }

    pub(crate) fn signal(&self, signal: &str) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args([signal, &pid]).status().unwrap().success());
    }

    pub(crate) fn wait(&mut self) -> ExitStatus {
        self.child.wait().unwrap()
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Builds tests/service/trace.c in `directory`.
pub(crate) fn tracer(directory: &Path) -> PathBuf {
    let library = directory.join("trace.so");
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/service/trace.c");
    let compiler = std::env::var_os("CC").unwrap_or("cc".into());
    let mut command = Command::new(&compiler);
    command.args(["-O1", "-shared", "-fPIC", source, "-ldl", "-o"]).arg(&library);
    let status = command.status().unwrap_or_else(|error| panic!("{}: {error}", compiler.display()));
    assert!(status.success(), "{command:?}");
    library
}

/// A new connection.
async fn channel(address: &str) -> Channel {
    Channel::from_shared(format!("http://{address}")).unwrap().connect().await.unwrap()
}
