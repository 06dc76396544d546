//! `hullcast query`: computes the contacts of a scene, in this process or on a server.

use std::io::{self, Write};
use std::path::PathBuf;

use super::Error;
use super::answer::{Answerer, at_server, in_scene, request};
use super::exit::Exit;
use super::options::{AccuracyArgs, OutputArg, QueryOptions};
use super::progress::Progress;
use super::remote::RemoteArgs;
use super::report::AnsweredFrame;
use super::scene::{Frame, SceneFile, frame_named, shown, unusable_poses};
use super::settings::MOST_THREADS;
use super::values::{count, counted, margin};
use hullcast::proto;

/// Pairs per request. This is well below every server's default limit, and so is the answer.
const PAIRS_PER_REQUEST: usize = 32_768;

/// Computes the contacts of a scene file, with the library in this process or on a server.
///
/// Both give the same answer, bit for bit.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Args {
    /// A scene file in the format hullcast.scene.v1; `-` for the standard input.
    scene: PathBuf,
    /// The configuration to query: its name, or its number from 0 [default: the first].
    #[arg(long, value_name = "NAME", allow_negative_numbers = true, help_heading = "Question")]
    frame: Option<String>,
    /// Compute contact points for hulls within this distance. `inf` means at any distance [default: the
    /// margin of the scene].
    #[arg(long, value_name = "LENGTH", allow_negative_numbers = true, value_parser = margin,
          help_heading = "Question")]
    margin: Option<f64>,
    /// Column groups to compute.
    #[arg(
        long,
        value_enum,
        ignore_case = true,
        value_delimiter = ',',
        value_name = "NAMES",
        help_heading = "Question",
        default_value = "alpha,normal,points,features,bases"
    )]
    outputs: Vec<OutputArg>,
    #[command(flatten)]
    accuracy: AccuracyArgs,
    /// Print separated pairs too.
    #[arg(long, help_heading = "Answer")]
    all: bool,
    /// Print JSON instead of a table.
    #[arg(long, help_heading = "Answer")]
    json: bool,
    /// Write the answer's columns to a .npz file, which `Manifolds.load` of the Python client reads
    /// [default: no file].
    #[arg(long, value_name = "FILE", help_heading = "Answer")]
    out: Option<PathBuf>,
    /// Compute threads in this process. 0 means one per core.
    #[arg(long, value_name = "COUNT", default_value_t = 0, allow_negative_numbers = true,
          value_parser = count(0, MOST_THREADS), help_heading = "Who answers")]
    threads: usize,
    #[command(flatten)]
    remote: RemoteArgs,
}

/// Runs `hullcast query`.
///
/// # Errors
/// The scene is not valid, or there is no answer, or it cannot be written.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    super::runtime::with_threads()?.block_on(answered(args))
}

async fn answered(args: &Args) -> Result<(), Error> {
    let scene = SceneFile::read("", &args.scene)?;
    let frame = match &args.frame {
        Some(wanted) => frame_named(&scene, wanted).map_err(|text| Exit::Usage.error(text))?,
        None => &scene.frames[0],
    };
    let options = args.accuracy.query_options(args.margin.unwrap_or(scene.margin), &args.outputs);
    let columns =
        fetch_answer(args, &scene, frame, &options).await.map_err(|error| match &args.remote.remote {
            Some(address) => at_server(error, address),
            None => error,
        })?;
    let answered = AnsweredFrame { scene: &scene, frame, columns: &columns };
    if let Some(path) = &args.out {
        answered.write_npz(path, &options.outputs).map_err(|e| format!("--out {}: {e}", path.display()))?;
    }
    let mut out = io::BufWriter::new(io::stdout().lock());
    let written =
        if args.json { answered.write_json(&mut out) } else { answered.write_table(&mut out, args.all) };
    match written.and_then(|()| out.flush()) {
        // A closed pipe, as in `hullcast query ... | head`, is not a failure.
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => {}
        other => other?,
    }
    all_answered(&columns, scene.body_hulls.len())
}

/// The columns of the answer, from this process or a server.
async fn fetch_answer(
    args: &Args,
    scene: &SceneFile,
    frame: &Frame,
    options: &QueryOptions,
) -> Result<proto::QueryContactsResponse, Error> {
    let opened = match &args.remote.remote {
        Some(address) => Answerer::remote(address, &args.remote, &scene.hulls).await,
        None => Answerer::local(&scene.hulls, args.threads),
    };
    let (answerer, ids) = opened.map_err(|error| in_scene(error, &shown("", &args.scene)))?;
    answer(&answerer, request(scene, frame, &ids, options)).await
}

/// Fails if a pair was not answered, because a script must not mistake such a pair for one without
/// contact.
fn all_answered(columns: &proto::QueryContactsResponse, bodies: usize) -> Result<(), Error> {
    const INVALID: u8 = proto::Outcome::Invalid as u8;
    let pairs = columns.outcomes.iter().filter(|&&outcome| outcome == INVALID).count();
    let of_all = format!("{pairs} of {}", counted(columns.outcomes.len(), "pair"));
    if !columns.invalid_bodies.is_empty() {
        let verb = if pairs == 1 { "is" } else { "are" };
        let unusable = unusable_poses(&columns.invalid_bodies, bodies);
        return Err(Exit::Unanswered.error(format!("{unusable}; {of_all} {verb} INVALID")));
    }
    if pairs > 0 {
        return Err(Exit::Unanswered
            .error(format!("{of_all} INVALID: the server has lost or cannot read their hulls; ask again")));
    }
    Ok(())
}

/// The columns of the whole answer. The request is sent in parts.
async fn answer(
    answerer: &Answerer,
    mut request: proto::QueryContactsRequest,
) -> Result<proto::QueryContactsResponse, Error> {
    let pairs = std::mem::take(&mut request.pairs);
    let progress = Progress::new("pairs", pairs.len() / 2);
    let mut whole = proto::QueryContactsResponse::default();
    let mut rest = pairs.as_slice();
    loop {
        let (now, later) = rest.split_at(rest.len().min(2 * PAIRS_PER_REQUEST));
        request.pairs = now.to_vec();
        hullcast_client::append(&mut whole, answerer.answer(request.clone()).await?);
        progress.add(now.len() / 2);
        rest = later;
        if rest.is_empty() {
            return Ok(whole);
        }
    }
}
