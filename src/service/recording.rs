//! Connects calls with the [`Recorder`].
//!
//! A recorded call has a [`Tape`], which is between the transport and all the code that serves the call: the request
//! passes it before anything is checked, and the answer passes it last. So the tape sees exactly the bytes of the wire.

use std::{
    io,
    pin::Pin,
    sync::{Arc, Mutex},
    task::{Context, Poll},
    time::Duration,
};

use bytes::Bytes;
use http::Response;
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use tokio::{runtime::Handle, time::timeout};
use tonic::{Code, Status, body::Body};

use super::{App, context::CallContext, method::Method};
use crate::{
    budget::Caller,
    compute::Job,
    lock::locked,
    proto::methods::{FIND_CONTACTS, QUERY_CONTACTS, REGISTER_HULLS, STREAM_CONTACTS},
    record::{RecordOptions, Recorder, Tape},
    store::HullId,
};

/// The methods whose calls are recorded: those whose answer follows from the request and the hulls.
const RECORDED: [&str; 4] = [QUERY_CONTACTS, FIND_CONTACTS, STREAM_CONTACTS, REGISTER_HULLS];

/// The time for the store to return a hull for a record. Hulls that take longer are missing in it.
const HULL_TIME: Duration = Duration::from_secs(5);

/// Starts to record the calls of `app`. The hulls of records are read from its store, one at a time and as a
/// caller of their own.
///
/// # Errors
/// The directory cannot be used, or the thread that writes cannot be started.
pub fn record(app: &Arc<App>, options: RecordOptions, runtime: Handle) -> io::Result<Arc<Recorder>> {
    let (hulls, metrics) = (app.clone(), app.metrics.clone());
    let job = Job::new(Caller::alone());
    let find = move |id: HullId| {
        let reader = hulls.registry().reader(&job);
        let found = runtime.block_on(async { timeout(HULL_TIME, reader.definition(id)).await });
        Some(found.ok()?.ok()?.identity_bytes())
    };
    Recorder::start(options, Box::new(find), metrics)
}

/// The tape of one call.
pub(super) type SharedTape = Arc<Mutex<Option<Tape>>>;

/// The tape of a call that begins now, if it may have to be recorded.
pub(super) fn tape(recorder: &Arc<Recorder>, method: &'static Method) -> Option<SharedTape> {
    if !RECORDED.contains(&method.name.as_str()) {
        return None;
    }
    let tape = recorder.tape(&method.name, method.is_long_lived())?;
    Some(Arc::new(Mutex::new(Some(tape))))
}

/// The body of a request, whose bytes go to the tape too.
pub(super) struct RecordedRequest<B> {
    body: B,
    tape: Option<SharedTape>,
}

impl<B> RecordedRequest<B> {
    /// `tape` is `None` if the call is not recorded.
    pub(super) fn new(body: B, tape: Option<SharedTape>) -> Self {
        Self { body, tape }
    }
}

impl<B: HttpBody<Data = Bytes> + Unpin> HttpBody for RecordedRequest<B> {
    type Data = Bytes;
    type Error = B::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, B::Error>>> {
        let polled = Pin::new(&mut self.body).poll_frame(cx);
        if let (Some(tape), Poll::Ready(Some(Ok(frame)))) = (&self.tape, &polled)
            && let (Some(tape), Some(bytes)) = (&mut *locked(tape), frame.data_ref())
        {
            tape.request(bytes);
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// The body of an answer, whose bytes go to the tape too. The tape ends with the body.
struct RecordedAnswer {
    body: Body,
    tape: SharedTape,
    context: CallContext,
    code: Code,
}

/// Lets the answer pass the tape. `status` is that of the response's headers, which have one only if there is no body.
pub(super) fn recorded(
    response: Response<Body>,
    tape: SharedTape,
    context: CallContext,
    status: Option<Status>,
) -> Response<Body> {
    let code = status.map_or(Code::Cancelled, |status| status.code());
    response.map(|body| Body::new(RecordedAnswer { body, tape, context, code }))
}

impl HttpBody for RecordedAnswer {
    type Data = Bytes;
    type Error = Status;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, Status>>> {
        let this = &mut *self;
        let polled = Pin::new(&mut this.body).poll_frame(cx);
        if let Poll::Ready(Some(Ok(frame))) = &polled {
            if let (Some(bytes), Some(tape)) = (frame.data_ref(), &mut *locked(&this.tape)) {
                tape.answer(bytes);
            }
            if let Some(status) = frame.trailers_ref().and_then(Status::from_header_map) {
                this.code = status.code();
            }
        }
        polled
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

impl Drop for RecordedAnswer {
    fn drop(&mut self) {
        let tape = locked(&self.tape).take();
        if let Some(tape) = tape {
            tape.end(self.code as u32, self.context.is_flagged());
        }
    }
}
