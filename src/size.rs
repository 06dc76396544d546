//! Prints and reads sizes, the same way in every message and every setting.

use std::{fmt, str::FromStr};

use serde::Serialize;

/// The units of sizes, the largest first.
const UNITS: [(&str, u64); 4] = [("TiB", 1 << 40), ("GiB", 1 << 30), ("MiB", 1 << 20), ("KiB", 1 << 10)];

/// A number of bytes that prints as people read sizes: `64 MiB`, `1000 bytes`. A size that is no whole
/// number of its unit is printed exactly and rounded: `67108865 bytes (64.0 MiB)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct ByteSize(pub u64);

impl fmt::Display for ByteSize {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(bytes) = *self;
        if bytes > 0
            && let Some((name, unit)) = UNITS.iter().find(|(_, unit)| bytes.is_multiple_of(*unit))
        {
            return write!(f, "{} {name}", bytes / unit);
        }
        let noun = if bytes == 1 { "byte" } else { "bytes" };
        match UNITS.iter().find(|(_, unit)| bytes >= *unit) {
            Some((name, unit)) => write!(f, "{bytes} {noun} ({:.1} {name})", bytes as f64 / *unit as f64),
            None => write!(f, "{bytes} {noun}"),
        }
    }
}

/// A number of bytes, or a number and one of the units KiB, MiB, GiB and TiB, as in `64MiB` or `64 MiB`.
impl FromStr for ByteSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let digits = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
        let (number, unit) = text.split_at(digits);
        let unit = match unit.strip_prefix(' ').unwrap_or(unit) {
            "" if digits == text.len() => Some(1),
            name => UNITS.iter().find(|(unit, _)| *unit == name).map(|(_, unit)| *unit),
        };
        let bytes = number.parse::<u64>().ok().zip(unit).and_then(|(number, unit)| number.checked_mul(unit));
        bytes.map(Self).ok_or_else(|| format!("{text:?} is not a size, as in 65536 or 64MiB"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a size that nobody can read, and one that hides the byte by which a limit is exceeded.
    #[test]
    fn sizes_have_units_and_are_exact() {
        for (bytes, text) in [
            (0, "0 bytes"),
            (1, "1 byte"),
            (1000, "1000 bytes"),
            (1024, "1 KiB"),
            (64 << 20, "64 MiB"),
            ((64 << 20) + 1, "67108865 bytes (64.0 MiB)"),
            (1536 << 20, "1536 MiB"),
            (2 << 30, "2 GiB"),
            (1 << 50, "1024 TiB"),
            (u64::MAX, "18446744073709551615 bytes (16777216.0 TiB)"),
        ] {
            assert_eq!(ByteSize(bytes).to_string(), text);
        }
    }

    /// Catches a unit that is misread, and a text that is taken for a size although it is none.
    #[test]
    fn sizes_are_read_with_units() {
        for (text, bytes) in [
            ("0", 0),
            ("512", 512),
            ("1KiB", 1024),
            ("64 MiB", 64 << 20),
            ("2GiB", 2 << 30),
            ("1TiB", 1 << 40),
        ] {
            assert_eq!(text.parse(), Ok(ByteSize(bytes)));
        }
        for text in [
            "",
            " ",
            "-1",
            "+1",
            "1.5GiB",
            "1MB",
            "1 ",
            "1  MiB",
            "MiB",
            "inf",
            "1e3",
            "99999999999GiB",
            "0x10",
        ] {
            assert!(text.parse::<ByteSize>().is_err(), "{text}");
        }
    }
}
