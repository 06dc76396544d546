//! The connection to the server that a subcommand uses: address, TLS and the caller's token.

use std::path::{Path, PathBuf};

use hullcast_client::{Address, Cause, Client, Defect, Setting, SettingError};

use super::Error;
use super::answer::QueryRefusal;
use super::exit::Exit;
use hullcast::small_file;

/// The options for querying a server instead of this process.
#[derive(clap::Args, Clone, Debug, Default)]
#[command(next_help_heading = "Who answers")]
pub(crate) struct RemoteArgs {
    /// Send the queries to this server instead of this process: host:port, unix:PATH, http://host:port or
    /// https://host:port. The port is 50051 if the address has none [default: this process].
    #[arg(long, value_name = "ADDRESS", value_parser = addresses)]
    pub(crate) remote: Option<String>,
    /// PEM file of the authorities that may have signed the server's certificate, or of a self-signed
    /// certificate [default: the system's authorities].
    #[arg(long, value_name = "FILE", requires = "remote")]
    tls_ca: Option<PathBuf>,
    /// PEM file of this client's certificate, for a server that asks for one [default: none].
    #[arg(long, value_name = "FILE", requires = "tls_key")]
    tls_certificate: Option<PathBuf>,
    /// PEM file of the private key of this client's certificate [default: none].
    #[arg(long, value_name = "FILE", requires = "tls_certificate")]
    tls_key: Option<PathBuf>,
    /// File whose first line is the token to send [default: no token].
    #[arg(long, value_name = "FILE", requires = "remote")]
    token_file: Option<PathBuf>,
}

/// Checks the addresses of an option, which are separated by commas.
///
/// # Errors
/// One of them is not an address.
fn addresses(text: &str) -> Result<String, String> {
    for address in text.split(',') {
        address.parse::<Address>().map_err(|error| error.to_string())?;
    }
    Ok(text.to_owned())
}

impl RemoteArgs {
    /// Opens a new connection to the server at `address`. Calls on it have no timeout and are not repeated:
    /// a load run counts the calls that a busy server refuses.
    ///
    /// # Errors
    /// No server answers at the address, or a file cannot be read or used.
    pub(crate) async fn connect(&self, address: &str) -> Result<Client, Error> {
        let parsed: Address = address.parse()?;
        let mut builder = Client::builder(address).timeout(None).retries(false);
        if let Some(path) = &self.token_file {
            let text = String::from_utf8_lossy(&read("--token-file", path)?).into_owned();
            builder = builder.token(text.lines().next().unwrap_or_default().trim());
        }
        if parsed.is_encrypted() {
            if let (Some(certificate), Some(key)) = (&self.tls_certificate, &self.tls_key) {
                builder = builder.identity(read("--tls-certificate", certificate)?, read("--tls-key", key)?);
            }
            if let Some(path) = &self.tls_ca {
                builder = builder.authority(read("--tls-ca", path)?);
            }
        } else if self.tls_ca.is_some() {
            let url = parsed.to_string();
            let host = url.trim_start_matches("http://");
            return Err(Exit::Usage.error(format!(
                "--tls-ca is for encrypted connections, and {address} is not one: write https://{host}, or leave \
                 --tls-ca out"
            )));
        }
        builder.connect().await.map_err(|error| self.failure(error))
    }

    /// The error of a connection, with the names of the options.
    fn failure(&self, error: hullcast_client::Error) -> Error {
        match &error {
            hullcast_client::Error::Setting(error) => self.unusable(error),
            hullcast_client::Error::Unreachable(why)
                if matches!(why.cause, Cause::SelfSigned | Cause::Untrusted(_)) =>
            {
                Exit::Unreachable.error(format!("{why} by --tls-ca"))
            }
            _ => QueryRefusal::from(error).into(),
        }
    }

    /// The error of a file whose content cannot be used.
    fn unusable(&self, error: &SettingError) -> Error {
        let (option, path) = match error.setting {
            Setting::Authority => ("--tls-ca", &self.tls_ca),
            Setting::Certificate => ("--tls-certificate", &self.tls_certificate),
            Setting::Key => ("--tls-key", &self.tls_key),
            Setting::Token => ("--token-file", &self.token_file),
        };
        let place = match path {
            Some(path) => format!("{option} {}", path.display()),
            None => format!("{option} is not given"),
        };
        match &error.defect {
            Defect::NotAToken => Exit::Input
                .error(format!("{place}: the first line is the token: one or more visible ASCII characters")),
            defect => Exit::Input.error(format!("{place}: {defect}")),
        }
    }
}

fn read(option: &str, path: &Path) -> Result<Vec<u8>, Error> {
    small_file::read(path)
        .map_err(|error| Exit::Input.error(format!("{option} {}: cannot be read: {error}", path.display())))
}
