//! `hullcast query`: computes the contacts of a scene, in this process or on a server.

use std::io::{self, Write};
use std::path::PathBuf;

use super::Error;
use super::answer::{Answerer, request};
use super::options::{AccuracyArgs, OutputArg};
use super::remote::RemoteArgs;
use super::report::Answered;
use super::scene::Scene;
use hullcast::proto;

/// Pairs per request. This is well below every server's default limit, and so is the answer.
const PAIRS_PER_REQUEST: usize = 32_768;

/// The contacts of a scene file, from the library in this process or from a server.
///
/// The two answers are the same to the last bit.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct Args {
    /// A scene file, hullcast.scene.v1.
    scene: PathBuf,
    #[command(flatten)]
    remote: RemoteArgs,
    /// Write the answer's columns to a .npz file.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Which configuration, from 0.
    #[arg(long, value_name = "INDEX", default_value_t = 0)]
    frame: usize,
    /// Contact points are wanted within it; inf: everywhere [default: the scene's].
    #[arg(long, value_name = "LENGTH")]
    margin: Option<f64>,
    /// Column groups to compute.
    #[arg(long, value_enum, value_delimiter = ',', value_name = "NAMES",
          default_values_t = [OutputArg::Alpha, OutputArg::Normal, OutputArg::Points, OutputArg::Features, OutputArg::Bases])]
    outputs: Vec<OutputArg>,
    /// Print separated pairs too.
    #[arg(long)]
    all: bool,
    /// Compute threads in this process; 0: one a core.
    #[arg(long, value_name = "COUNT", default_value_t = 0)]
    threads: usize,
    #[command(flatten)]
    accuracy: AccuracyArgs,
}

/// Runs `hullcast query`.
///
/// # Errors
/// The scene is not valid, or there is no answer, or it cannot be written.
pub(crate) fn run(args: &Args) -> Result<(), Error> {
    tokio::runtime::Runtime::new()?.block_on(answered(args))
}

async fn answered(args: &Args) -> Result<(), Error> {
    let scene = Scene::read(&args.scene).map_err(|e| format!("{}: {e}", args.scene.display()))?;
    let frame = scene.frames.get(args.frame).ok_or_else(|| {
        format!("--frame {}: {} has {} frames, from 0", args.frame, args.scene.display(), scene.frames.len())
    })?;
    let (answerer, ids) = match &args.remote.remote {
        Some(address) => Answerer::remote(address, &args.remote, &scene.hulls).await?,
        None => Answerer::local(&scene.hulls, args.threads)?,
    };
    let asked = args.accuracy.asked(args.margin.unwrap_or(scene.margin), &args.outputs);
    let columns = answer(&answerer, request(&scene, frame, &ids, &asked)).await?;
    let answered = Answered { scene: &scene, frame, columns: &columns };
    if let Some(path) = &args.out {
        answered.write_npz(path).map_err(|e| format!("{}: {e}", path.display()))?;
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

/// Fails if a pair was not answered, because a script must not take such a pair for one without contact.
fn all_answered(columns: &proto::QueryContactsResponse, bodies: usize) -> Result<(), Error> {
    const INVALID: u8 = proto::Outcome::Invalid as u8;
    const SHOWN: usize = 8;
    let pairs = columns.outcomes.iter().filter(|&&outcome| outcome == INVALID).count();
    let unusable = &columns.invalid_bodies;
    if !unusable.is_empty() {
        let mut names: Vec<String> = unusable.iter().take(SHOWN).map(u32::to_string).collect();
        if unusable.len() > SHOWN {
            names.push("...".into());
        }
        let message = format!(
            "unusable poses: {} of {bodies} bodies (bodies {}), so that {pairs} of {} pairs are INVALID. \
             A position is finite and at most 1e100, a quaternion's norm 0.25 to 4",
            unusable.len(),
            names.join(", "),
            columns.outcomes.len()
        );
        return Err(message.into());
    }
    if pairs > 0 {
        let message = format!(
            "{pairs} of {} pairs are INVALID: the server has lost or cannot read their hulls; ask again",
            columns.outcomes.len()
        );
        return Err(message.into());
    }
    Ok(())
}

/// The columns of the whole request, which is sent in parts.
async fn answer(
    answerer: &Answerer,
    mut request: proto::QueryContactsRequest,
) -> Result<proto::QueryContactsResponse, Error> {
    let pairs = std::mem::take(&mut request.pairs);
    let mut whole = proto::QueryContactsResponse::default();
    let mut rest = pairs.as_slice();
    loop {
        let (now, later) = rest.split_at(rest.len().min(2 * PAIRS_PER_REQUEST));
        request.pairs = now.to_vec();
        append(&mut whole, answerer.answer(request.clone()).await?);
        rest = later;
        if rest.is_empty() {
            return Ok(whole);
        }
    }
}

/// Appends the columns of a part.
fn append(whole: &mut proto::QueryContactsResponse, part: proto::QueryContactsResponse) {
    whole.outcomes.extend(part.outcomes);
    whole.flags.extend(part.flags);
    whole.alphas.extend(part.alphas);
    whole.alpha_lowers.extend(part.alpha_lowers);
    whole.alpha_uppers.extend(part.alpha_uppers);
    whole.separations.extend(part.separations);
    whole.normals.extend(part.normals);
    whole.point_counts.extend(part.point_counts);
    whole.witness_as.extend(part.witness_as);
    whole.distances.extend(part.distances);
    whole.witness_bs.extend(part.witness_bs);
    whole.feature_kinds.extend(part.feature_kinds);
    whole.feature_indices.extend(part.feature_indices);
    whole.point_ids.extend(part.point_ids);
    whole.bases.extend(part.bases);
    whole.iterations.extend(part.iterations);
    whole.support_calls.extend(part.support_calls);
    whole.kept_areas.extend(part.kept_areas);
    // These describe the whole request, so every part has the same.
    whole.missing_hulls = part.missing_hulls;
    whole.invalid_bodies = part.invalid_bodies;
}
