//! A server in a process of its own, and its CPU time.

use std::error::Error;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};

/// A running server. Dropping it kills the process.
pub struct Server {
    child: Child,
    /// The address, host:port.
    pub address: String,
}

/// CPU time since the server's start, in nanoseconds.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cpu {
    /// Time of the compute threads.
    pub compute: f64,
    /// Time of all other threads: transport, decoding, encoding and looking up hulls.
    pub rest: f64,
}

impl Cpu {
    /// Time of all threads.
    pub fn total(self) -> f64 {
        self.compute + self.rest
    }

    pub fn since(self, before: Self) -> Self {
        Self { compute: self.compute - before.compute, rest: self.rest - before.rest }
    }
}

impl Server {
    /// Starts `program`, whose first output line must be `listening on ADDRESS`.
    pub fn start(program: &str, arguments: &[&str]) -> Result<Self, Box<dyn Error>> {
        let mut child = Command::new(program)
            .args(arguments)
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|e| format!("{program}: {e}"))?;
        let output = child.stdout.take().ok_or("no output")?;
        let mut line = String::new();
        BufReader::new(output).read_line(&mut line)?;
        let address = line.trim().strip_prefix("listening on ").ok_or("the server did not start")?;
        Ok(Self { child, address: address.to_owned() })
    }

    /// Starts the hullcast server whose path is in `HULLCAST_BIN`.
    pub fn hullcast() -> Result<Self, Box<dyn Error>> {
        Self::hullcast_with(&[])
    }

    /// Starts the hullcast server with additional arguments.
    pub fn hullcast_with(more: &[&str]) -> Result<Self, Box<dyn Error>> {
        let program = std::env::var("HULLCAST_BIN").map_err(|_| "HULLCAST_BIN names the server's binary")?;
        Self::binary(&program, more)
    }

    /// Starts the hullcast server of this path with additional arguments.
    pub fn binary(program: &str, more: &[&str]) -> Result<Self, Box<dyn Error>> {
        let arguments = ["serve", "--listen", "127.0.0.1:0", "--store", "memory://", "--log", "error"];
        Self::start(program, &[&arguments, more].concat())
    }

    /// The CPU time that the server's threads have used.
    pub fn cpu(&self) -> Result<Cpu, Box<dyn Error>> {
        let mut cpu = Cpu::default();
        for task in std::fs::read_dir(format!("/proc/{}/task", self.child.id()))? {
            let task = task?.path();
            // The thread may have ended in the meantime.
            let Ok(times) = std::fs::read_to_string(task.join("schedstat")) else { continue };
            let name = std::fs::read_to_string(task.join("comm")).unwrap_or_default();
            let used: f64 = times.split(' ').next().ok_or("no schedstat")?.parse()?;
            if name.starts_with("compute-") {
                cpu.compute += used;
            } else {
                cpu.rest += used;
            }
        }
        Ok(cpu)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
