//! `hullcast serve`: answers queries over gRPC until it is told to stop.

use std::{
    io::{self, Read, Write},
    path::PathBuf,
    sync::Arc,
    time::Duration,
};

use hullcast::{
    service::{App, Listener, Security, run as serve, serve_admin},
    store::blobs,
    trace,
};
use tokio::{
    net::TcpListener,
    runtime::Builder,
    signal::unix::{SignalKind, signal},
    sync::oneshot,
};
use tracing_subscriber::{
    EnvFilter, Layer,
    filter::{FilterExt, filter_fn},
    layer::SubscriberExt,
    util::SubscriberInitExt,
};

use super::{
    Error, descriptors,
    settings::{Given, LogFormat, Settings},
    traces::Traces,
};

/// `hullcast serve`
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    given: Given,
    /// A TOML file with the same settings, named as the flags, with underscores
    #[arg(long, env = "HULLCAST_CONFIG", value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print the settings in force as such a file, and exit
    #[arg(long)]
    print_config: bool,
    /// Sleep so many microseconds for every pair: for tests of overload
    #[arg(long, hide = true, default_value_t = 0)]
    inject_pair_delay_us: u64,
    /// Stop when standard input closes, as when the parent process ends
    #[arg(long)]
    until_stdin_closes: bool,
}

/// Threads for blocking work outside the store, which has threads of its own: reading certificates and
/// tokens again, and looking up names. By default tokio would start up to 512.
const BLOCKING_THREADS: usize = 8;

/// The time that this work has to end after serving. The store's threads are not waited for.
const RUNTIME_SHUTDOWN: Duration = Duration::from_secs(1);

/// Runs `hullcast serve`.
pub(crate) fn run(args: Args) -> Result<(), Error> {
    let file = args.config.as_deref().map(Given::read).transpose()?.unwrap_or_default();
    let settings = args.given.clone().or(file);
    if args.print_config {
        print!("{}", toml::to_string(&settings)?);
        return Ok(());
    }
    let runtime = Builder::new_multi_thread().enable_all().max_blocking_threads(BLOCKING_THREADS).build()?;
    let traces = {
        let _entered = runtime.enter();
        observe(&settings)?
    };
    let result = runtime.block_on(until_stopped(&settings, &args));
    if let Some(traces) = traces {
        traces.flush();
    }
    runtime.shutdown_timeout(RUNTIME_SHUTDOWN);
    result
}

async fn until_stopped(settings: &Settings, args: &Args) -> Result<(), Error> {
    let serving = settings.serving()?;
    let store = blobs::open(&settings.store)?;
    let mut limits = settings.limits()?;
    limits.max_connections = descriptors::connections(limits.max_connections);
    let app = Arc::new(App::new(store, limits, settings.compute_threads)?);
    app.engine().injected().delay(Duration::from_micros(args.inject_pair_delay_us));
    let grace = settings.grace()?;
    // Installed before the address is printed: a reader of the address may stop the server at once.
    let shutdown = shutdown(grace, args.until_stdin_closes)?;
    let listeners = listeners(settings, &serving.security).await?;
    let admin = match settings.admin_listen.as_str() {
        "" => None,
        address => {
            let bound = TcpListener::bind(address).await;
            Some(bound.map_err(|error| format!("admin_listen {address}: {error}"))?)
        }
    };
    announce(&listeners, admin.as_ref())?;
    if let Some(admin) = admin {
        tokio::spawn(serve_admin(admin, app.clone()));
    }
    tracing::info!(
        version = env!("CARGO_PKG_VERSION"),
        store = settings.store,
        compute_threads = app.engine().threads(),
        "serving"
    );
    spawn_reload_on_hangup(serving.security.clone())?;
    Ok(serve(listeners, app, serving, shutdown).await?)
}

/// Binds the addresses. Refuses one that other machines can reach in plain text, unless the settings
/// allow it.
async fn listeners(settings: &Settings, security: &Security) -> Result<Vec<Listener>, Error> {
    let mut listeners = Vec::with_capacity(settings.listen.len());
    for address in &settings.listen {
        let listener = Listener::bind(address).await?;
        if listener.is_exposed()? && !security.encrypts() && !settings.allow_plaintext {
            return Err(format!(
                "{address}: other machines can reach it and nothing is encrypted: \
                 give --tls-certificate and --tls-key, or --allow-plaintext"
            )
            .into());
        }
        listeners.push(listener);
    }
    Ok(listeners)
}

/// Completes when the server is told to stop, and returns the grace period. After a supervisor's
/// signal load balancers must hear of the stop first, so there is a grace period. After an interrupt,
/// or after the end of standard input, there is none. If the server is told to stop again, the process
/// ends at once.
fn shutdown(grace: Duration, until_stdin_closes: bool) -> io::Result<impl Future<Output = Duration>> {
    let (mut terminate, mut interrupt) = (signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?);
    Ok(async move {
        let grace = tokio::select! {
            _ = terminate.recv() => grace,
            _ = interrupt.recv() => Duration::ZERO,
            () = stdin_closed(), if until_stdin_closes => Duration::ZERO,
        };
        tokio::spawn(async move {
            tokio::select! {
                _ = terminate.recv() => {}
                _ = interrupt.recv() => {}
            }
            tracing::warn!("told to stop again: ending at once");
            std::process::exit(1);
        });
        grace
    })
}

/// Reads certificates and tokens again after SIGHUP, as daemons do. They are also read periodically.
fn spawn_reload_on_hangup(security: Arc<Security>) -> io::Result<()> {
    let mut hangup = signal(SignalKind::hangup())?;
    tokio::spawn(async move {
        while hangup.recv().await.is_some() {
            let security = security.clone();
            let _ = tokio::task::spawn_blocking(move || security.reload()).await;
        }
    });
    Ok(())
}

/// Prints one line per listener to standard output, for which scripts wait, then one for the admin port.
fn announce(listeners: &[Listener], admin: Option<&TcpListener>) -> io::Result<()> {
    let mut out = io::stdout().lock();
    for listener in listeners {
        writeln!(out, "listening on {listener}")?;
    }
    if let Some(admin) = admin {
        writeln!(out, "admin on {}", admin.local_addr()?)?;
    }
    out.flush()
}

/// Completes when standard input closes. Reading happens on a thread of its own, because a read of
/// standard input cannot be cancelled and must not keep the runtime from ending.
async fn stdin_closed() {
    let (closed, wait) = oneshot::channel();
    std::thread::spawn(move || {
        let mut buffer = [0; 1024];
        let mut stdin = io::stdin().lock();
        while stdin.read(&mut buffer).is_ok_and(|bytes| bytes > 0) {}
        let _ = closed.send(());
    });
    let _ = wait.await;
}

/// Sends logs to standard error, and traces to a collector if one is configured.
fn observe(settings: &Settings) -> Result<Option<Traces>, Error> {
    let filter = EnvFilter::try_new(&settings.log).map_err(|error| format!("log: {error}"))?;
    let filter = filter.and(filter_fn(|metadata| metadata.target() != trace::TARGET));
    let log = tracing_subscriber::fmt::layer().with_writer(io::stderr);
    let log = match settings.log_format {
        LogFormat::Text => log.with_ansi(false).boxed(),
        LogFormat::Json => log.json().boxed(),
    };
    let traces = match settings.otlp_endpoint.as_str() {
        "" => None,
        endpoint => Some(Traces::open(endpoint, settings.otlp_share)?),
    };
    let layer = traces.as_ref().map(Traces::layer);
    tracing_subscriber::registry().with(log.with_filter(filter)).with(layer).init();
    Ok(traces)
}
