//! A stream of requests: answered in order, one at a time, each perhaps inheriting
//! from the one before.

use std::{sync::Arc, time::Duration};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tonic::{Status, Streaming};

use super::{
    App, ServiceError,
    contacts::answer,
    edge::Closing,
    wire::{self, Setting},
};
use crate::{
    compute::Job,
    proto::{QueryContactsRequest, QueryContactsResponse},
};

/// When a client of a server that stops, or keeps too much for others, should ask again.
const RETRY: Duration = Duration::from_millis(100);

/// The unit in which what streams keep is counted.
const KEPT_UNIT: usize = 1 << 10;

/// What all streams together may keep between messages.
pub(super) fn room(bytes: u64) -> Arc<Semaphore> {
    let units = usize::try_from(bytes).unwrap_or(usize::MAX) / KEPT_UNIT;
    Arc::new(Semaphore::new(units.min(Semaphore::MAX_PERMITS)))
}

/// A stream of requests being answered.
pub(super) struct Steps {
    app: Arc<App>,
    requests: Streaming<QueryContactsRequest>,
    closing: Closing,
    job: Job,
    previous: Previous,
}

/// The message before.
enum Previous {
    /// There was none.
    None,
    /// There was no room to keep it.
    Dropped,
    /// What the next message may inherit.
    Kept { setting: Arc<Setting>, bases: Vec<u32>, room: OwnedSemaphorePermit },
}

impl Steps {
    /// Ends when the requests do, and once `closing` is true: after the message under way.
    pub(super) fn new(
        app: Arc<App>,
        requests: Streaming<QueryContactsRequest>,
        closing: Closing,
        job: Job,
    ) -> Self {
        Self { app, requests, closing, job, previous: Previous::None }
    }

    /// The next answer; none at the end of the requests.
    pub(super) async fn next(&mut self) -> Result<Option<QueryContactsResponse>, Status> {
        let request = tokio::select! {
            biased;
            () = self.closing.heard() => {
                let why = "the connection is about to close: open the stream again";
                return Err(ServiceError::unavailable("STOPPING", RETRY, why).into());
            }
            request = self.requests.message() => request.map_err(wire::complete)?,
        };
        match request {
            None => Ok(None),
            Some(request) => Ok(Some(self.step(request).await?)),
        }
    }

    async fn step(&mut self, request: QueryContactsRequest) -> Result<QueryContactsResponse, ServiceError> {
        let previous = std::mem::replace(&mut self.previous, Previous::None);
        let (scene, room) = match (request.inherit, previous) {
            (false, previous) => {
                drop(previous);
                (wire::scene(request, self.app.limits())?, None)
            }
            (true, Previous::Kept { setting, bases, room }) => {
                (wire::inherited(request, setting, bases)?, Some(room))
            }
            (true, Previous::None) => {
                let why = "a stream's first message says everything itself";
                return Err(ServiceError::invalid("NOTHING_TO_INHERIT", "inherit", why));
            }
            (true, Previous::Dropped) => {
                let why = "the streams of this server keep too much: send the message in full";
                return Err(ServiceError::unavailable("STATE_NOT_KEPT", RETRY, why));
            }
        };
        let setting = scene.setting.clone();
        let (response, bases) = answer(&self.app, scene, true, &self.job).await?;
        self.previous = match room.or_else(|| self.room_for(&setting)) {
            Some(room) => Previous::Kept { setting, bases, room },
            None => Previous::Dropped,
        };
        Ok(response)
    }

    fn room_for(&self, setting: &Setting) -> Option<OwnedSemaphorePermit> {
        let units = u32::try_from(setting.kept_bytes().div_ceil(KEPT_UNIT)).ok()?;
        self.app.stream_room.clone().try_acquire_many_owned(units).ok()
    }
}
