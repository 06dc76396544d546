//! Checks the complete settings, and converts them to the options and limits of the server.

use std::{net::IpAddr, sync::Arc, time::Duration};

use hullcast::{
    record::RecordOptions,
    service::{Limits, LoadError, Security, SecurityFiles, ServerOptions},
};

use super::declared::{LONGEST, MOST_THREADS, NAMES, SHORTEST_LOOP, SHORTEST_TIME, Settings, Switch};
use crate::cli::{
    Error,
    exit::Exit,
    serve_values::{filter, overlap},
};

/// The text about an empty `listen`.
pub(super) const AT_LEAST_ONE: &str = "must have at least one address, host:port or unix:PATH";

/// The checked settings of a server.
pub(crate) struct CheckedSettings {
    pub(crate) options: ServerOptions,
    pub(crate) limits: Limits,
    /// The time for which a server that stops still accepts calls, while health reports NOT_SERVING.
    pub(crate) grace: Duration,
    /// The calls to record; `None` if no directory is set.
    pub(crate) record: Option<RecordOptions>,
}

impl Settings {
    /// Checks all settings, and reads the security files that they name. Whether the addresses, the store
    /// and the collector can be used is only known once they are opened.
    ///
    /// # Errors
    /// A file cannot be used, a value is outside its range, or settings contradict each other.
    pub(crate) fn check(&self) -> Result<CheckedSettings, Error> {
        self.check_addresses().map_err(|why| Exit::Usage.error(why))?;
        filter(&self.log)
            .map_err(|why| Exit::Usage.error(format!("{} is {:?}: {why}", self.shown("log"), self.log)))?;
        let limits = self.limits()?;
        if let Some(fault) = limits.contradiction() {
            return Err(Exit::Usage.error(self.shown_in(&fault)));
        }
        let (options, grace, record) = (self.options()?, self.grace()?, self.record()?);
        Ok(CheckedSettings { options, limits, grace, record })
    }

    /// The calls to record.
    ///
    /// # Errors
    /// A value is outside its range.
    fn record(&self) -> Result<Option<RecordOptions>, Error> {
        let slow = self.seconds("record_slow_seconds", self.record_slow_seconds, 0.0)?;
        let share = self.record_share;
        if !(0.0..=1.0).contains(&share) {
            let name = self.shown("record_share");
            return Err(Exit::Usage.error(format!("{name} is {share}, must be 0 to 1")));
        }
        let options = RecordOptions {
            directory: self.record.clone(),
            max_bytes: self.record_bytes.0,
            share,
            slow: Some(slow).filter(|slow| !slow.is_zero()),
            failed: self.record_failed,
            flagged: self.record_flagged,
        };
        Ok(Some(options).filter(|options| !options.directory.as_os_str().is_empty()))
    }

    /// The name of a setting as the user knows it: its key if the file gives its value, otherwise its flag.
    pub(crate) fn shown(&self, name: &str) -> String {
        if self.of_file.contains(&name) { name.to_owned() } else { format!("--{}", name.replace('_', "-")) }
    }

    /// A text about limits, with each setting as the user knows it.
    fn shown_in(&self, text: &str) -> String {
        let of_name = |letter: char| letter.is_ascii_lowercase() || letter == '_';
        let mut shown = String::new();
        let mut rest = text;
        while let Some(start) = rest.find(of_name) {
            let (before, word) = rest.split_at(start);
            let (word, after) = word.split_at(word.find(|letter| !of_name(letter)).unwrap_or(word.len()));
            shown += before;
            // A name of one word, such as `store`, is an ordinary word in these texts.
            shown +=
                &if word.contains('_') && NAMES.contains(&word) { self.shown(word) } else { word.to_owned() };
            rest = after;
        }
        shown + rest
    }

    /// The error of a security file, with each setting as the user knows it.
    fn not_loaded(&self, error: LoadError) -> Error {
        match error {
            LoadError::Missing { setting } => {
                let [certificate, key, authorities] =
                    ["tls_certificate", "tls_key", "tls_client_ca"].map(|name| self.shown(name));
                Exit::Usage.error(format!(
                    "{} is missing: TLS needs {certificate} and {key}, and {authorities} works only with both",
                    self.shown(setting)
                ))
            }
            LoadError::File { setting, path, why } => {
                Exit::Input.error(format!("{} {}: {why}", self.shown(setting), path.display()))
            }
        }
    }

    /// Refuses addresses that exclude each other, and a proxy that is named twice.
    fn check_addresses(&self) -> Result<(), String> {
        if self.listen.is_empty() {
            return Err(format!("{} is empty, {AT_LEAST_ONE}", self.shown("listen")));
        }
        for (i, address) in self.listen.iter().enumerate() {
            if let Some(other) = self.listen[..i].iter().find(|other| overlap(other, address)) {
                return Err(format!(
                    "{} names {other} and {address}, of which only one can be bound: leave one out",
                    self.shown("listen")
                ));
            }
            if overlap(address, &self.admin_listen) {
                return Err(format!(
                    "{} is {}, which contradicts {} {address}: choose another port for one of them",
                    self.shown("admin_listen"),
                    self.admin_listen,
                    self.shown("listen")
                ));
            }
        }
        let proxies: Vec<_> = self.trusted_proxies.iter().map(IpAddr::to_canonical).collect();
        match (1..proxies.len()).find(|&i| proxies[..i].contains(&proxies[i])) {
            Some(twice) => Err(format!(
                "{} names {} twice: leave it out once",
                self.shown("trusted_proxies"),
                proxies[twice]
            )),
            None => Ok(()),
        }
    }

    /// Refuses what this build does not have, and origins of pages that nothing would answer.
    fn check_browsers(&self) -> Result<(), Error> {
        for (name, is_on, is_built) in [
            ("playground", self.playground, cfg!(feature = "playground")),
            ("grpc_web", self.grpc_web, cfg!(feature = "grpc-web")),
        ] {
            if is_on && !is_built {
                let feature = name.replace('_', "-");
                return Err(Exit::Usage.error(format!(
                    "{} is true, but this server was built without it: build it by `cargo build --release \
                     --features {feature}`",
                    self.shown(name)
                )));
            }
        }
        if !self.grpc_web_origins.is_empty() && !self.grpc_web && !self.playground {
            return Err(Exit::Usage.error(format!(
                "{} is set, but neither gRPC-web nor the playground is on: set {} to true, or remove the origins",
                self.shown("grpc_web_origins"),
                self.shown("grpc_web")
            )));
        }
        Ok(())
    }

    /// The options of the server. Reads the security files that the settings name.
    ///
    /// # Errors
    /// A file cannot be used, or a value is outside its range.
    fn options(&self) -> Result<ServerOptions, Error> {
        let (threads, share) = (self.compute_threads, self.otlp_share);
        if threads > MOST_THREADS {
            let name = self.shown("compute_threads");
            return Err(Exit::Usage.error(format!("{name} is {threads}, must be 0 to {MOST_THREADS}")));
        }
        if !(0.0..=1.0).contains(&share) {
            let name = self.shown("otlp_share");
            return Err(Exit::Usage.error(format!("{name} is {share}, must be 0 to 1")));
        }
        let files = SecurityFiles {
            tls_certificate: self.tls_certificate.clone(),
            tls_key: self.tls_key.clone(),
            tls_client_ca: self.tls_client_ca.clone(),
            query_tokens: self.query_tokens.clone(),
            register_tokens: self.register_tokens.clone(),
        };
        self.check_browsers()?;
        Ok(ServerOptions {
            security: Arc::new(Security::open(&files).map_err(|error| self.not_loaded(error))?),
            reload_every: self.seconds("reload_seconds", self.reload_seconds, SHORTEST_LOOP)?,
            drain: self.seconds("drain_seconds", self.drain_seconds, 0.0)?,
            max_connection_age: self.seconds(
                "max_connection_age_seconds",
                self.max_connection_age_seconds,
                0.0,
            )?,
            probe_every: self.seconds("probe_seconds", self.probe_seconds, SHORTEST_LOOP)?,
            message_time: self.seconds("message_seconds", self.message_seconds, SHORTEST_TIME)?,
            answer_time: self.seconds("answer_seconds", self.answer_seconds, SHORTEST_TIME)?,
            trusted_proxies: self.trusted_proxies.iter().map(IpAddr::to_canonical).collect(),
            #[cfg(feature = "playground")]
            playground: self.playground,
            #[cfg(feature = "grpc-web")]
            grpc_web: self.grpc_web,
            #[cfg(feature = "grpc-web")]
            grpc_web_origins: self.grpc_web_origins.clone(),
            ..ServerOptions::default()
        })
    }

    /// The value of [`CheckedSettings::grace`].
    ///
    /// # Errors
    /// The value is outside its range.
    fn grace(&self) -> Result<Duration, Error> {
        self.seconds("grace_seconds", self.grace_seconds, 0.0)
    }

    /// The value of a setting in seconds, at least `least`.
    ///
    /// # Errors
    /// The value is outside its range, or is not a number.
    fn seconds(&self, name: &str, value: f64, least: f64) -> Result<Duration, Error> {
        if (least..=LONGEST).contains(&value) {
            return Ok(Duration::try_from_secs_f64(value)?);
        }
        let name = self.shown(name);
        Err(Exit::Usage.error(format!("{name} is {value}, must be {least} to {LONGEST} seconds")))
    }

    /// The limits among the settings.
    ///
    /// # Errors
    /// A size is a percentage, and the system does not report its memory.
    fn limits(&self) -> Result<Limits, Error> {
        Ok(Limits {
            max_message_bytes: usize::try_from(self.max_message_bytes.0).unwrap_or(usize::MAX),
            max_pairs_per_request: self.max_pairs_per_request,
            max_bodies_per_request: self.max_bodies_per_request,
            max_hulls_per_request: self.max_hulls_per_request,
            max_vertices_per_hull: self.max_vertices_per_hull,
            max_points_per_hull: self.max_points_per_hull,
            max_memory_bytes: self.max_memory_bytes.bytes()?,
            shares: self.shares == Switch::On,
            max_pairs_in_flight: self.max_pairs_in_flight,
            max_request_bytes_in_flight: self.max_request_bytes_in_flight.0,
            max_deadline_seconds: self.max_deadline_seconds,
            max_connections: self.max_connections,
            max_stream_state_bytes: self.max_stream_state_bytes.0,
            cache_bytes: self.cache_bytes.bytes()?,
            store_bytes: self.store_bytes.0,
            max_streams_per_connection: self.max_streams_per_connection,
            max_page_size: self.max_page_size,
            cache_age_seconds: self.cache_age_seconds,
            store_seconds: self.store_seconds,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::{memory::MemorySize, settings::PartialSettings};

    /// Catches addresses that contradict each other, which only the system would refuse, as if another
    /// server had them.
    #[test]
    fn contradicting_addresses_are_refused_by_name() {
        let with = |listen: &[&str], admin: &str, proxies: &[&str]| {
            let mut settings = PartialSettings::default().or(PartialSettings::default());
            settings.listen = listen.iter().map(|&address| address.to_owned()).collect();
            settings.admin_listen = admin.into();
            settings.trusted_proxies = proxies.iter().map(|address| address.parse().unwrap()).collect();
            settings.check().map_or_else(|error| error.to_string(), |_| String::new())
        };
        assert!(with(&[], "", &[]).contains("--listen is empty, must have at least one address"));
        let twice = with(&["127.0.0.1:7", "unix:a", "127.0.0.1:7"], "", &[]);
        assert!(twice.contains("--listen names 127.0.0.1:7 and 127.0.0.1:7"), "{twice}");
        let both = with(&["127.0.0.1:7"], "0.0.0.0:7", &[]);
        assert!(
            both.contains("--admin-listen is 0.0.0.0:7, which contradicts --listen 127.0.0.1:7"),
            "{both}"
        );
        let proxies = with(&["127.0.0.1:7"], "", &["10.0.0.1", "::ffff:10.0.0.1"]);
        assert!(proxies.contains("--trusted-proxies names 10.0.0.1 twice"), "{proxies}");
        assert_eq!(with(&["127.0.0.1:0", "127.0.0.1:0", "unix:a"], "127.0.0.1:0", &["10.0.0.1"]), "");
    }

    /// Catches a reversed order of precedence.
    #[test]
    fn flags_win_over_the_file_and_the_file_over_defaults() {
        let flags = PartialSettings { cache_bytes: Some(MemorySize::Bytes(1)), ..PartialSettings::default() };
        let file = PartialSettings {
            cache_bytes: Some(MemorySize::Bytes(2)),
            max_page_size: Some(3),
            ..PartialSettings::default()
        };
        let settings = flags.or(file);
        assert_eq!(settings.cache_bytes, MemorySize::Bytes(1));
        assert_eq!(settings.max_page_size, 3);
        assert_eq!(settings.limits().unwrap().max_pairs_per_request, Limits::default().max_pairs_per_request);
    }

    /// Catches a setting of the file that is shown as a flag, which the user did not give, and a flag that is
    /// shown as a key. A path may contain the name of a setting.
    #[test]
    fn settings_are_shown_as_the_user_gave_them() {
        let refused = |flags: PartialSettings, file: PartialSettings| match flags.or(file).check() {
            Ok(_) => panic!("not refused"),
            Err(error) => error.to_string(),
        };
        let named =
            |path: &str| PartialSettings { tls_certificate: Some(path.into()), ..PartialSettings::default() };
        let missing = "is missing: TLS needs";
        let said = refused(named("c.pem"), PartialSettings::default());
        assert!(
            said.starts_with(&format!("--tls-key {missing} --tls-certificate and --tls-key, and ")),
            "{said}"
        );
        let said = refused(PartialSettings::default(), named("c.pem"));
        assert!(
            said.starts_with(&format!("--tls-key {missing} tls_certificate and --tls-key, and ")),
            "{said}"
        );
        let both = PartialSettings { tls_key: Some("tls_key/k.pem".into()), ..named("tls_key/c.pem") };
        let said = refused(both.clone(), PartialSettings::default());
        assert!(said.starts_with("--tls-certificate tls_key/c.pem: cannot be read: No such file"), "{said}");
        let said = refused(PartialSettings::default(), both);
        assert!(said.starts_with("tls_certificate tls_key/c.pem: "), "{said}");
        let few = || PartialSettings { max_pairs_in_flight: Some(5), ..PartialSettings::default() };
        let rule =
            "is 5, must be at least 131072 (--max-pairs-per-request): the largest request would never run";
        assert_eq!(refused(few(), PartialSettings::default()), format!("--max-pairs-in-flight {rule}"));
        assert_eq!(refused(PartialSettings::default(), few()), format!("max_pairs_in_flight {rule}"));
    }

    /// Catches a value outside its range that is accepted, or refused without its name, value and range.
    #[test]
    fn values_outside_their_ranges_are_refused_by_name() {
        type Spoil = fn(&mut Settings);
        let spoils: [(Spoil, &str, &str); 10] = [
            (|s| s.grace_seconds = -1.0, "--grace-seconds is -1", "0 to 1000000000"),
            (|s| s.grace_seconds = f64::NAN, "--grace-seconds is NaN", "0 to 1000000000"),
            (|s| s.drain_seconds = f64::INFINITY, "--drain-seconds is inf", "0 to 1000000000"),
            (|s| s.drain_seconds = 1e300, "--drain-seconds is 1", "0 to 1000000000"),
            (|s| s.max_connection_age_seconds = -0.5, "--max-connection-age-seconds is -0.5", "0 to"),
            (|s| s.probe_seconds = 0.0, "--probe-seconds is 0", "0.01 to 1000000000"),
            (|s| s.reload_seconds = 0.009, "--reload-seconds is 0.009", "0.01 to 1000000000"),
            (|s| s.compute_threads = 4097, "--compute-threads is 4097", "0 to 4096"),
            (|s| s.otlp_share = 1.5, "--otlp-share is 1.5", "0 to 1"),
            (|s| s.otlp_share = f64::NAN, "--otlp-share is NaN", "0 to 1"),
        ];
        for (spoil, value, range) in spoils {
            let mut settings = PartialSettings::default().or(PartialSettings::default());
            assert!(settings.grace().is_ok() && settings.options().is_ok());
            spoil(&mut settings);
            let error = settings.grace().map(|_| ()).and_then(|()| settings.options().map(|_| ()));
            let error = error.expect_err(value).to_string();
            assert!(error.contains(value) && error.contains(range), "{error}");
        }
    }
}
