//! `hullcast replay`: computes recorded calls again and compares the answers.

use std::{
    io,
    net::Ipv4Addr,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use hullcast::{
    proto,
    record::{Call, Content, DIGEST_BYTES, Entries, Header, REASONS, digest, files},
    service::{App, Limits, Listener, ServerOptions, run as serve},
    store::{HullDefinition, blobs},
};
use hullcast_client::{Client, Hull};
use tonic::{Code, Status};

use super::{Error, exit::Exit, remote::RemoteArgs, runtime, values::count, values::counted};

/// Computes recorded calls again, and compares each message of their answers with its recorded digest.
///
/// One server without hulls is started in this process and answers the calls of all files. With --remote, the
/// server at that address answers instead. The hulls of the records are registered with it first.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Args {
    /// A directory of records, or one file of it.
    #[arg(value_name = "PATH")]
    records: PathBuf,
    /// Threads that compute in this process; 0 means one per core.
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Who answers",
          value_parser = count(0, super::settings::MOST_THREADS), allow_negative_numbers = true)]
    threads: usize,
    #[command(flatten)]
    remote: RemoteArgs,
}

/// Hulls are registered when their points are this many, so that the hulls of a file need not fit into memory.
const POINTS_AT_A_TIME: usize = 100_000;

/// Runs `hullcast replay`.
///
/// # Errors
/// A record differs or cannot be sent again, or a file is damaged. All files are replayed first.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    runtime::with_threads()?.block_on(replay(args))
}

/// The counts of a replay.
#[derive(Default)]
struct Totals {
    calls: u64,
    messages: u64,
    differing: u64,
    damaged: u64,
}

async fn replay(args: &Args) -> Result<(), Error> {
    let path = &args.records;
    let unreadable =
        |error: io::Error| Exit::Input.error(format!("{}: cannot be read: {error}", path.display()));
    let files = files(path).map_err(unreadable)?;
    if files.is_empty() {
        return Err(Exit::Input.error(format!("{}: has no file of records", path.display())));
    }
    let client = match &args.remote.remote {
        Some(address) => args.remote.connect(address).await?,
        None => start(args.threads).await?,
    };
    let mut totals = Totals::default();
    for file in files {
        replay_file(&file, &client, &mut totals).await?;
    }
    println!(
        "{}, {} of their answers compared: {} differ",
        counted(totals.calls, "call"),
        counted(totals.messages, "message"),
        totals.differing
    );
    match totals {
        Totals { differing: 1.., .. } => {
            Err(Exit::Failed.error(format!("{} not answered as recorded", counted(totals.differing, "call"))))
        }
        Totals { damaged: 1.., .. } => {
            Err(Exit::Input.error(format!("{} damaged", counted(totals.damaged, "file"))))
        }
        _ => Ok(()),
    }
}

/// Starts a server in this process that has no hulls, and connects to it.
async fn start(threads: usize) -> Result<Client, Error> {
    let limits = Limits::default();
    let app = Arc::new(App::new(blobs::open("memory://")?, limits, threads)?);
    let listener = Listener::bind(&format!("{}:0", Ipv4Addr::LOCALHOST)).await?;
    let address = listener.to_string();
    let never = std::future::pending::<Duration>();
    tokio::spawn(serve(vec![listener], app, ServerOptions::default(), never));
    RemoteArgs::default().connect(&address).await
}

/// Sends the calls of one file again. Its hulls are registered before the first call that follows them.
async fn replay_file(path: &Path, client: &Client, totals: &mut Totals) -> Result<(), Error> {
    let entries = match Entries::open(path) {
        Ok(entries) => entries,
        Err(error) => {
            eprintln!("{}: cannot be opened: {error}", path.display());
            totals.damaged += 1;
            return Ok(());
        }
    };
    let (mut hulls, mut points, mut header, mut number) = (Vec::new(), 0, Header::default(), 0_u64);
    for entry in entries {
        match entry {
            Ok(Content::Header(of_file)) => header = of_file,
            Ok(Content::Hull(bytes)) => match HullDefinition::from_identity_bytes(&bytes) {
                Some(hull) => {
                    points += hull.points.len();
                    hulls.push(of_definition(hull));
                    if points > POINTS_AT_A_TIME {
                        register(client, std::mem::take(&mut hulls)).await?;
                        points = 0;
                    }
                }
                None => eprintln!(
                    "{}: the identity bytes of a hull before call {number} are not valid, so the hull is skipped",
                    path.display()
                ),
            },
            Ok(Content::Call(call)) => {
                register(client, std::mem::take(&mut hulls)).await?;
                points = 0;
                totals.calls += 1;
                let compared = compare(client, &call).await;
                totals.messages += compared.messages;
                if let Some(difference) = compared.difference {
                    let of = format!("{}: call {number} ({})", path.display(), call.method);
                    eprintln!("{of}: {difference}{}", circumstances(&header, &call));
                    totals.differing += 1;
                }
                number += 1;
            }
            Err(damage) => {
                eprintln!("{damage}; replayed before it: {}", counted(number, "call"));
                totals.damaged += u64::from(!damage.is_cut);
            }
        }
    }
    Ok(())
}

fn of_definition(definition: HullDefinition) -> Hull {
    let HullDefinition { points, contraction_point, simplification, planarity } = definition;
    let simplification = simplification
        .map(|of| proto::Simplification { max_vertices: of.max_vertices, max_deviation: of.max_deviation });
    Hull { points, contraction_point, simplification, planarity }
}

/// Registers hulls with the server that answers.
async fn register(client: &Client, hulls: Vec<Hull>) -> Result<(), Error> {
    if !hulls.is_empty() {
        client.put(&hulls).await.map_err(super::answer::QueryRefusal::from)?;
    }
    Ok(())
}

/// The circumstances of a record, for the message about a difference.
fn circumstances(header: &Header, call: &Call) -> String {
    let Header { version, instruction_set, contract } = header;
    let reason = REASONS.get(call.reason as usize).unwrap_or(&"");
    let seconds = call.took_ns as f64 / 1e9;
    let mut text = format!(
        "; it was recorded (reason: {reason}) by version {version}, contract {contract}, with {instruction_set}, and \
         took {seconds:.6} s"
    );
    if call.missing_hulls > 0 {
        text += &format!("; {} missing in the record", counted(call.missing_hulls, "hull"));
    }
    text
}

/// The result of sending a call again.
struct Compared {
    /// The number of messages of the answer that were compared.
    messages: u64,
    /// The first difference.
    difference: Option<String>,
}

/// Sends a call again.
///
/// If the record is cut, or the code depends on more than the request and the hulls, the recorded messages only have to
/// be the first of the answer. Otherwise the code and the number of messages have to be the same too.
async fn compare(client: &Client, call: &Call) -> Compared {
    let messages = match call.messages() {
        Ok(messages) => messages,
        Err(why) => return Compared { messages: 0, difference: Some(why.into()) },
    };
    let recorded: Vec<&[u8]> = call.digests.chunks(DIGEST_BYTES).collect();
    let code = Code::from(call.code as i32);
    let is_whole = !call.cut && matches!(code, Code::Ok | Code::InvalidArgument | Code::FailedPrecondition);
    let (mut answers, mut differs) = (0, None);
    let ended = client.raw(&call.method, messages, |answer| {
        if recorded.get(answers).is_some_and(|recorded| **recorded != digest(answer)) {
            differs = differs.or(Some(answers));
        }
        answers += 1;
    });
    let status = ended.await.err().unwrap_or_else(|| Status::new(Code::Ok, ""));
    let compared = recorded.len().min(answers);
    let difference = if let Some(at) = differs {
        Some(format!("message {at} of the answer differs"))
    } else if recorded.len() > answers || (is_whole && recorded.len() < answers) {
        let why = if status.code() == Code::Ok { String::new() } else { format!(": {}", status.message()) };
        Some(format!("the answer has {answers} messages instead of {}{why}", recorded.len()))
    } else if is_whole && status.code() != code {
        Some(format!("the call ends with {:?} instead of {code:?}: {}", status.code(), status.message()))
    } else {
        None
    };
    Compared { messages: compared as u64, difference }
}
