"""The package's version: that of Cargo.toml, which the wheel takes."""

__version__ = "0.1.0"
