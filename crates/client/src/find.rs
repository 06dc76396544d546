//! The search for pairs.

use hullcast_proto::{QueryContactsRequest, QueryContactsResponse};
use tonic::{Request, Streaming};

use crate::checked::Found;
use crate::client::{Deadline, by};
use crate::{Client, Error, append};

/// The answer to a search for pairs, message by message ([`Client::find`]).
///
/// Dropping it ends the search on the server.
#[derive(Debug)]
pub struct Search {
    request: QueryContactsRequest,
    callers_id: u64,
    messages: Streaming<QueryContactsResponse>,
    first: Option<QueryContactsResponse>,
    found: Found,
    deadline: Deadline,
    has_ended: bool,
}

impl Client {
    /// Finds the pairs of a scene that may touch, and answers them.
    ///
    /// The request has bodies and a finite margin, and no pairs. `worlds`, `groups` and `ignored_groups` say
    /// which bodies may meet. The answer has every pair that may meet and is not SEPARATED, in ascending
    /// order; its column `pairs` has the bodies. It arrives in messages of some thousand pairs, which the
    /// server computes as they are read: the call returns when the first message is there. The timeout bounds
    /// the whole search.
    ///
    /// The first message names the hulls that the server lacks (`missing_hulls`) and the bodies whose poses
    /// are unusable (`invalid_bodies`). No pair of the answer has such a hull or body; this is not an error.
    ///
    /// # Errors
    /// [`Error::Refused`] if the request is malformed or over a limit. If the server is busy or lost, the call
    /// is repeated only before the first message.
    pub async fn find(&self, request: &QueryContactsRequest) -> Result<Search, Error> {
        let deadline = self.deadline();
        let callers_id = request.request_id;
        let request = QueryContactsRequest { request_id: Self::next_request_id(), ..request.clone() };
        let (messages, first) = self.repeated(deadline, || self.begin(deadline, request.clone())).await?;
        self.check_contract(deadline, &request, &first).await?;
        let mut search = Search {
            request,
            callers_id,
            messages,
            first: None,
            found: Found::default(),
            deadline,
            has_ended: false,
        };
        search.first = Some(search.checked(first)?);
        Ok(search)
    }

    /// Finds and answers the pairs as [`Client::find`] does, and joins all messages to one answer.
    ///
    /// # Errors
    /// Those of [`Client::find`] and [`Search::next`].
    pub async fn find_all(&self, request: &QueryContactsRequest) -> Result<QueryContactsResponse, Error> {
        let mut search = self.find(request).await?;
        let mut whole = search.next().await?.unwrap_or_default();
        let (missing, invalid) = (whole.missing_hulls.clone(), whole.invalid_bodies.clone());
        while let Some(message) = search.next().await? {
            append(&mut whole, message);
        }
        // Only the first message has these lists.
        Ok(QueryContactsResponse { missing_hulls: missing, invalid_bodies: invalid, ..whole })
    }

    async fn begin(
        &self,
        deadline: Deadline,
        request: QueryContactsRequest,
    ) -> Result<(Streaming<QueryContactsResponse>, QueryContactsResponse), Error> {
        let mut stub = self.contacts();
        by(deadline, async {
            let mut messages = stub.find_contacts(Request::new(request)).await?.into_inner();
            let first = messages.message().await?;
            let first = first.ok_or_else(|| crate::Malformed::new("a search has no message"))?;
            Ok((messages, first))
        })
        .await?
    }
}

impl Search {
    /// The next message of the answer, or `None` at the end. Its columns are those of a query's answer, and
    /// `pairs` has the bodies of each pair, the lower first.
    ///
    /// # Errors
    /// [`Error::Lost`], [`Error::TimedOut`] or [`Error::Refused`] if the search cannot go on. The messages
    /// before the error remain valid. [`Error::Cut`] if the caller waited so long between two messages that
    /// the server gave up.
    pub async fn next(&mut self) -> Result<Option<QueryContactsResponse>, Error> {
        if let Some(first) = self.first.take() {
            return Ok(Some(first));
        }
        if self.has_ended {
            return Ok(None);
        }
        // If the future is dropped here, the next call goes on waiting for the same message.
        let message = match by(self.deadline, self.messages.message()).await {
            Ok(Ok(Some(message))) => message,
            Ok(Ok(None)) => {
                self.has_ended = true;
                return Ok(None);
            }
            Ok(Err(status)) => return Err(status.into()),
            Err(late) => return Err(late),
        };
        self.checked(message).map(Some)
    }

    fn checked(&mut self, mut message: QueryContactsResponse) -> Result<QueryContactsResponse, Error> {
        self.found.check(&self.request, &message)?;
        message.request_id = self.callers_id;
        Ok(message)
    }
}
