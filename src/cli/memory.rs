//! The memory that this process may use, and sizes given as percentages of it.

use std::{
    fmt, fs,
    path::{Path, PathBuf},
    str::FromStr,
};

use hullcast::{service::Limits, size::ByteSize};
use rustix::process::{Resource, getrlimit};
use serde::{Serialize, Serializer};

/// A size in bytes, or as a percentage of the memory that the process may use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum MemorySize {
    /// A number of bytes.
    Bytes(u64),
    /// A percentage.
    Share(f64),
}

impl MemorySize {
    /// The size in bytes. A percentage refers to the memory of this machine and this cgroup.
    ///
    /// # Errors
    /// The size is a percentage, and the system does not report its memory.
    pub(crate) fn bytes(self) -> Result<u64, String> {
        match self {
            Self::Bytes(bytes) => Ok(bytes),
            Self::Share(percent) => {
                let memory =
                    available(Path::new("/")).ok_or("the system does not say how much memory there is")?;
                Ok((memory as f64 * percent / 100.0) as u64)
            }
        }
    }
}

impl FromStr for MemorySize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(percent) = text.strip_suffix('%') {
            let percent: f64 = percent.parse().map_err(|error| format!("{text}: {error}"))?;
            return match percent {
                _ if percent > 0.0 && percent <= 100.0 => Ok(Self::Share(percent)),
                _ => Err(format!("{text}: expected more than 0% and at most 100%")),
            };
        }
        text.parse().map(|ByteSize(bytes)| Self::Bytes(bytes))
    }
}

impl fmt::Display for MemorySize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bytes(bytes) => write!(f, "{bytes}"),
            Self::Share(percent) => write!(f, "{percent}%"),
        }
    }
}

/// Written as a number if the size is in bytes, otherwise as text.
impl Serialize for MemorySize {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Bytes(bytes) => serializer.serialize_u64(*bytes),
            Self::Share(_) => serializer.collect_str(self),
        }
    }
}

/// Memory of the process besides the budget and the cache (docs/budget.md).
const OF_THE_PROCESS: u64 = 256 << 20;

/// Logs if the process may not have as much address space as callers can make it use: the allocator would
/// end the process.
pub(crate) fn compare(limits: &Limits) {
    let needed = limits.max_memory_bytes.saturating_add(limits.cache_bytes).saturating_add(OF_THE_PROCESS);
    if let Some(allowed) = getrlimit(Resource::As).current.filter(|&allowed| allowed < needed) {
        tracing::warn!(
            allowed = %ByteSize(allowed),
            needed = %ByteSize(needed),
            "the system allows less address space (ulimit -v) than max_memory_bytes, cache_bytes and 256 MiB \
             together: callers may be able to end the process"
        );
    }
}

/// The machine's memory in bytes, or the limit of this process's cgroups if that is less. `root` is `/`
/// outside tests. In both versions of cgroups, each group on the path to the root may set a limit.
fn available(root: &Path) -> Option<u64> {
    let read = |path: PathBuf| fs::read_to_string(path).ok();
    let info = read(root.join("proc/meminfo"))?;
    let total = info.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kib: u64 = total.trim().strip_suffix("kB")?.trim().parse().ok()?;
    let mut least = kib << 10;
    for line in read(root.join("proc/self/cgroup")).unwrap_or_default().lines() {
        let mut parts = line.splitn(3, ':');
        let (_, controllers, path) = (parts.next(), parts.next(), parts.next());
        let (Some(controllers), Some(path)) = (controllers, path) else { continue };
        let (base, file) = match controllers {
            "" => ("sys/fs/cgroup", "memory.max"),
            _ if controllers.split(',').any(|name| name == "memory") => {
                ("sys/fs/cgroup/memory", "memory.limit_in_bytes")
            }
            _ => continue,
        };
        let base = root.join(base);
        // In a container, /proc shows the path on the host, but the container's own group is mounted at
        // the base.
        for group in base.join(path.trim_start_matches('/')).ancestors() {
            if let Some(limit) = read(group.join(file)).and_then(|text| text.trim().parse::<u64>().ok()) {
                least = least.min(limit);
            }
            if group == base {
                break;
            }
        }
    }
    Some(least)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a unit or a percentage that is misread, and settings that do not read back.
    #[test]
    fn sizes_are_numbers_units_or_shares() {
        for (text, size) in [
            ("1073741824", MemorySize::Bytes(1 << 30)),
            ("512MiB", MemorySize::Bytes(512 << 20)),
            ("25%", MemorySize::Share(25.0)),
            ("12.5%", MemorySize::Share(12.5)),
        ] {
            assert_eq!(text.parse(), Ok(size));
            assert_eq!(size.to_string().parse(), Ok(size));
        }
        for text in ["", "0%", "-1%", "-1", "1MB", "101%", "x%", "NaN%", "99999999999GiB"] {
            assert!(text.parse::<MemorySize>().is_err(), "{text}");
        }
    }

    /// Catches a cache whose size follows the machine's memory although the container has less, with
    /// either version of cgroups.
    #[test]
    fn the_least_of_machine_and_cgroups_counts() {
        let root = tempfile::tempdir().unwrap();
        let write = |path: &str, text: &str| {
            let path = root.path().join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, text).unwrap();
        };
        assert_eq!(available(root.path()), None);
        write("proc/meminfo", "MemFree: 1 kB\nMemTotal:       1024 kB\n");
        assert_eq!(available(root.path()), Some(1 << 20));
        write("proc/self/cgroup", "0::/a/b\n");
        write("sys/fs/cgroup/a/b/memory.max", "max\n");
        assert_eq!(available(root.path()), Some(1 << 20));
        write("sys/fs/cgroup/a/memory.max", "700000\n");
        assert_eq!(available(root.path()), Some(700_000));
        write("sys/fs/cgroup/a/b/memory.max", "600000\n");
        assert_eq!(available(root.path()), Some(600_000));
        write("proc/self/cgroup", "5:cpu,memory:/docker/1\n3:pids:/docker/1\n");
        write("sys/fs/cgroup/memory/memory.limit_in_bytes", "500000\n");
        assert_eq!(available(root.path()), Some(500_000));
        write("sys/fs/cgroup/memory/docker/1/memory.limit_in_bytes", "9223372036854771712\n");
        assert_eq!(available(root.path()), Some(500_000));
    }
}
