//! The answer to a message of a stream that names its pairs.

use tokio::time::Instant;

use super::{AnswerPart, StepAnswer};
use crate::{
    batch::Batch,
    budget::{Part, Permit},
    proto::QueryContactsResponse,
    service::{ServiceError, admission::Admission, scene::log_answered},
};

/// Computes the named pairs of a message. `warm_starts` are those that the request has, and `memory` is the memory of
/// the decoded message.
pub(in crate::service) async fn answer_named(
    answer: &mut StepAnswer,
    admission: Admission,
    warm_starts: Vec<u32>,
    memory: Permit,
) -> Result<QueryContactsResponse, ServiceError> {
    let started = tracing::enabled!(tracing::Level::DEBUG).then(Instant::now);
    if let Some(response) = answer.repeated().await? {
        return Ok(response);
    }
    let mut batch = Batch::new(answer.bodies.clone(), warm_starts)?;
    if let Some(step) = &answer.step {
        batch.follow(step.clone());
    }
    batch.keep_for_steps();
    batch.keep(memory);
    let (app, context) = (answer.app.clone(), answer.context.clone());
    let memory = context.covered(Part::Answers);
    let lease = Some(answer.lease.clone());
    let (columns, memory) = app.engine().compute(batch, lease, admission, &context.job, memory).await?;
    context.note_flags(&columns.flags);
    if let Some(started) = started {
        let (outputs, bodies) = (answer.scene.template.outputs(), answer.bodies.count());
        let (hulls, invalid) = (&answer.missing_hulls, &answer.scene.invalid_bodies);
        log_answered(answer.request_id, bodies, &columns, outputs, hulls, invalid, started);
    }
    match answer.part(columns, None, memory, true).await? {
        AnswerPart::More(response) | AnswerPart::Last(response) => Ok(response),
        AnswerPart::TooLarge(error) => Err(error),
    }
}
