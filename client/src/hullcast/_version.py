"""The package's version: the same as in Cargo.toml, from which the wheel takes its version."""

__version__ = "0.1.0"
