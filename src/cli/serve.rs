//! `hullcast serve`: answers queries over gRPC until it is told to stop.

use std::{
    io::{self, Read, Write},
    net::{IpAddr, Ipv4Addr, Ipv6Addr},
    path::PathBuf,
    sync::Arc,
    time::Duration,
};

use hullcast::{
    service::{self, App, Listener, Security, StartError, run as serve, serve_admin},
    store::blobs::{self, StoreOpenError},
};
use tokio::{
    net::TcpListener,
    runtime::{Builder, Handle},
    signal::unix::{SignalKind, signal},
    sync::oneshot,
};

use crate::allocator;

use super::{
    Error, descriptors,
    exit::Exit,
    log, memory, runtime,
    settings::{CheckedSettings, DEFAULT_STORE, PartialSettings, Settings},
};

/// `hullcast serve`
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    settings: PartialSettings,
    /// Read settings from this TOML file. Its keys are the names of the flags, with underscores
    /// [default: none]
    #[arg(long, env = "HULLCAST_CONFIG", value_name = "FILE", help_heading = "Settings")]
    config: Option<PathBuf>,
    /// Print the settings that apply, in the format of --config, and exit
    #[arg(long, help_heading = "Settings")]
    print_config: bool,
    /// Sleep for this many microseconds per pair, so that scripts/overload knows the server's capacity
    #[cfg(feature = "testing")]
    #[arg(long, hide = true, default_value_t = 0, allow_negative_numbers = true,
          value_parser = super::values::count(0, u64::MAX))]
    inject_pair_delay_us: u64,
    /// Stop when standard input closes, for example because the parent process has ended
    #[arg(long, help_heading = "Stopping")]
    until_stdin_closes: bool,
}

/// Threads for blocking work outside the store, which has threads of its own: looking up names. By default
/// tokio would start up to 512.
const BLOCKING_THREADS: usize = 8;

/// The time that this work has to end after serving. The store's threads are not waited for.
const RUNTIME_SHUTDOWN: Duration = Duration::from_secs(1);

/// The time for the last records to be written when the server stops.
const RECORDS_FLUSH: Duration = Duration::from_secs(5);

/// Runs `hullcast serve`.
pub(crate) fn run(args: Args) -> Result<(), Error> {
    let file = args.config.as_deref().map(PartialSettings::read).transpose()?.unwrap_or_default();
    let settings = args.settings.clone().or(file);
    let mut checked = settings.check()?;
    if args.print_config {
        print!("{}", toml::to_string(&settings)?);
        return Ok(());
    }
    let descriptors = descriptors::checked(&settings)?;
    let mut builder = Builder::new_multi_thread();
    let runtime = runtime::start(builder.enable_all().max_blocking_threads(BLOCKING_THREADS))?;
    let observed = {
        let _entered = runtime.enter();
        log::start(&settings)?
    };
    let limits = &mut checked.limits;
    limits.max_connections = descriptors.connections(limits.max_connections);
    memory::compare(limits);
    let result = runtime.block_on(until_stopped(&settings, checked, &args));
    observed.flush();
    if let Ok(StopKind::AtOnce) = result {
        // Dropping the runtime would wait for work on other threads.
        std::process::exit(1);
    }
    runtime.shutdown_timeout(RUNTIME_SHUTDOWN);
    result.map(|_| ())
}

/// How the server stopped.
enum StopKind {
    /// The calls in progress ended first.
    Drained,
    /// It was told to stop a second time.
    AtOnce,
}

async fn until_stopped(
    settings: &Settings,
    checked: CheckedSettings,
    args: &Args,
) -> Result<StopKind, Error> {
    let CheckedSettings { mut options, limits, grace, record } = checked;
    let store = blobs::open(&settings.store).map_err(|error| match error {
        StoreOpenError::Threads(why) => Exit::Failed.error(runtime::refused(&why)),
        error @ StoreOpenError::Store(_) => Exit::Usage.error(format!("--{error}")),
    })?;
    let app = App::new(store, limits, settings.compute_threads).map_err(|error| match error {
        StartError::Threads(why) => Exit::Failed.error(runtime::refused(&why)),
        error => error.into(),
    })?;
    let app = Arc::new(app);
    if let Some(record) = record {
        let name = format!("{} {}", settings.shown("record"), record.directory.display());
        let recorder = service::record(&app, record, Handle::current());
        let recorder =
            recorder.map_err(|error| Exit::Usage.error(format!("{name}: cannot be used: {error}")))?;
        options.recorder = Some(recorder);
    }
    let recorder = options.recorder.clone();
    #[cfg(feature = "testing")]
    app.engine().test_controls().delay(Duration::from_micros(args.inject_pair_delay_us));
    // Installed before the address is printed: a reader of the address may stop the server at once.
    let (again, told_again) = oneshot::channel();
    let shutdown = shutdown(grace, args.until_stdin_closes, again)?;
    let listeners = listeners(settings, &options.security).await?;
    let admin = match settings.admin_listen.as_str() {
        "" => None,
        address => {
            let bound = TcpListener::bind(address).await;
            let named = |error: io::Error| io::Error::new(error.kind(), format!("{address}: {error}"));
            Some(bound.map_err(|error| not_bound("--admin-listen", address, &named(error)))?)
        }
    };
    let refused = |error: io::Error| Exit::Failed.error(runtime::refused(&error.to_string()));
    allocator::return_freed_memory(Handle::current()).map_err(refused)?;
    announce(settings, options.security.encrypts(), &listeners, admin.as_ref())?;
    if let Some(admin) = admin {
        tokio::spawn(serve_admin(admin, app.clone()));
    }
    tracing::info!(
        version = env!("CARGO_PKG_VERSION"),
        store = settings.store,
        compute_threads = app.engine().threads(),
        "serving"
    );
    spawn_reload_on_hangup(options.security.clone())?;
    tokio::select! {
        served = serve(listeners, app, options, shutdown) => {
            served?;
            if let Some(recorder) = recorder {
                // The last records may wait for the store and the disk, which must not be waited for without end.
                tokio::task::block_in_place(|| recorder.flush(RECORDS_FLUSH));
            }
            Ok(StopKind::Drained)
        }
        Ok(()) = told_again => {
            tracing::warn!("told to stop again: ending at once");
            Ok(StopKind::AtOnce)
        }
    }
}

/// Binds the addresses. Refuses one that other machines can reach in plain text, unless the settings
/// allow it.
async fn listeners(settings: &Settings, security: &Security) -> Result<Vec<Listener>, Error> {
    let mut listeners = Vec::with_capacity(settings.listen.len());
    for address in &settings.listen {
        let bound = Listener::bind(address).await;
        let listener = bound.map_err(|error| not_bound("--listen", address, &error))?;
        if listener.is_exposed()? && !security.encrypts() && !settings.allow_plaintext {
            return Err(Exit::Usage.error(format!(
                "--listen {address}: other machines can reach it and nothing is encrypted: \
                 give --tls-certificate and --tls-key, or --allow-plaintext"
            )));
        }
        listeners.push(listener);
    }
    Ok(listeners)
}

/// Completes when the server is told to stop, and returns the grace period. After a supervisor's
/// signal load balancers must hear of the stop first, so there is a grace period. After an interrupt,
/// or after the end of standard input, there is none. `again` hears of a second signal.
fn shutdown(
    grace: Duration,
    until_stdin_closes: bool,
    again: oneshot::Sender<()>,
) -> Result<impl Future<Output = Duration>, Error> {
    let (mut terminate, mut interrupt) = (signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?);
    let closed = if until_stdin_closes { Some(stdin_closed()?) } else { None };
    let closed = async {
        match closed {
            Some(closed) => _ = closed.await,
            None => std::future::pending().await,
        }
    };
    Ok(async move {
        let grace = tokio::select! {
            _ = terminate.recv() => grace,
            _ = interrupt.recv() => Duration::ZERO,
            () = closed => Duration::ZERO,
        };
        tokio::spawn(async move {
            tokio::select! {
                _ = terminate.recv() => {}
                _ = interrupt.recv() => {}
            }
            let _ = again.send(());
        });
        grace
    })
}

/// Reads certificates and tokens again after SIGHUP, as daemons do. They are also read periodically.
fn spawn_reload_on_hangup(security: Arc<Security>) -> io::Result<()> {
    let mut hangup = signal(SignalKind::hangup())?;
    tokio::spawn(async move {
        while hangup.recv().await.is_some() {
            security.clone().reload_aside().await;
        }
    });
    Ok(())
}

/// The reason why an address was not bound.
fn not_bound(option: &str, address: &str, error: &io::Error) -> Error {
    let remedy = if error.kind() == io::ErrorKind::AddrInUse {
        let other = if address.starts_with("unix:") { "path" } else { "port" };
        format!("; another server has it: stop that one, or choose another {other}")
    } else {
        String::new()
    };
    Exit::Usage.error(format!("{option} {error}{remedy}"))
}

/// Prints one line per listener, for which scripts wait, then the address of the admin port. Further
/// lines are for people: the address of the playground, and the directory of the hulls if it is the
/// default.
fn announce(
    settings: &Settings,
    encrypts: bool,
    listeners: &[Listener],
    admin: Option<&TcpListener>,
) -> io::Result<()> {
    let mut text: String = listeners.iter().map(|listener| format!("listening on {listener}\n")).collect();
    if let Some(admin) = admin {
        text += &format!("admin on {}\n", admin.local_addr()?);
    }
    if settings.playground {
        let urls = listeners.iter().filter_map(|listener| page(listener, encrypts));
        text.extend(urls.map(|url| format!("playground at {url}\n")));
    }
    if settings.store == DEFAULT_STORE {
        let folder = std::path::absolute(DEFAULT_STORE)?;
        text += &format!("hulls are kept in {} (the default of --store)\n", folder.display());
    }
    // Everything is written at once, because a script may close the pipe when it has read the first
    // line.
    let mut out = io::stdout().lock();
    out.write_all(text.as_bytes())?;
    out.flush()
}

/// The URL of the playground. None for a Unix socket, which browsers cannot open.
fn page(listener: &Listener, encrypts: bool) -> Option<String> {
    let Listener::Tcp(listener) = listener else { return None };
    let mut address = listener.local_addr().ok()?;
    match address.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => address.set_ip(Ipv4Addr::LOCALHOST.into()),
        IpAddr::V6(ip) if ip.is_unspecified() => address.set_ip(Ipv6Addr::LOCALHOST.into()),
        _ => {}
    }
    let scheme = if encrypts { "https" } else { "http" };
    Some(format!("{scheme}://{address}/"))
}

/// The receiver completes when standard input closes. Reading happens on a thread of its own, because a read of
/// standard input cannot be cancelled and must not keep the runtime from ending.
fn stdin_closed() -> Result<oneshot::Receiver<()>, Error> {
    let (closed, wait) = oneshot::channel();
    let read = move || {
        let mut buffer = [0; 1024];
        let mut stdin = io::stdin().lock();
        while stdin.read(&mut buffer).is_ok_and(|bytes| bytes > 0) {}
        let _ = closed.send(());
    };
    let started = std::thread::Builder::new().name("stdin".into()).spawn(read);
    started.map_err(|error| Exit::Failed.error(runtime::refused(&error.to_string())))?;
    Ok(wait)
}
