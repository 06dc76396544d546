//! Load on a server: calls in closed loops, streams, and the server's CPU time while they run.

use std::error::Error;
use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use tokio::sync::mpsc;

use super::process::{Cpu, Server};
use super::raw::{RawClient, next};
use super::requests::STREAM;

type Failure = Box<dyn Error>;

/// Duration of one measurement.
pub const SECONDS: f64 = 1.0;

/// The upper median.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Sends `message` in `under_way` loops for `SECONDS`. Each loop starts a call at least `pause` after
/// its previous one. Returns the number of calls.
pub async fn load(
    client: &RawClient,
    message: &Bytes,
    under_way: usize,
    pause: Duration,
) -> Result<u64, Failure> {
    let start = Instant::now();
    let end = start + Duration::from_secs_f64(SECONDS);
    let loops = (0..under_way).map(|place| {
        let (mut client, message) = (client.clone(), message.clone());
        tokio::spawn(async move {
            let mut calls = 0;
            let mut at = start + pause * place as u32 / under_way as u32;
            while at.max(Instant::now()) < end {
                if !pause.is_zero() {
                    tokio::time::sleep_until(at.into()).await;
                    at += pause;
                }
                client.call(message.clone()).await?;
                calls += 1;
            }
            Ok::<u64, tonic::Status>(calls)
        })
    });
    let mut calls = 0;
    for each in loops.collect::<Vec<_>>() {
        calls += each.await??;
    }
    Ok(calls)
}

/// The server's CPU time per pair during `work`, which returns its number of pairs, and the number of
/// pairs per second.
pub async fn measured(
    server: &Server,
    work: impl Future<Output = Result<u64, Failure>>,
) -> Result<(Cpu, f64), Failure> {
    let (before, start) = (server.cpu()?, Instant::now());
    let pairs = work.await? as f64;
    let seconds = start.elapsed().as_secs_f64();
    let used = server.cpu()?.since(before);
    Ok((Cpu { compute: used.compute / pairs, rest: used.rest / pairs }, pairs / seconds))
}

pub async fn latencies(client: &mut RawClient, message: &Bytes, calls: usize) -> Result<Vec<f64>, Failure> {
    let mut times = Vec::with_capacity(calls);
    for _ in 0..calls {
        let start = Instant::now();
        client.call(message.clone()).await?;
        times.push(start.elapsed().as_secs_f64() * 1e6);
    }
    Ok(times)
}

/// The number of messages answered within `SECONDS` by `streams` streams, each with `under_way`
/// messages in flight.
pub async fn streamed(
    address: &str,
    streams: usize,
    under_way: usize,
    first: &Bytes,
    rest: &Bytes,
) -> Result<u64, Failure> {
    let answered = Arc::new(AtomicU64::new(0));
    let end = Instant::now() + Duration::from_secs_f64(SECONDS);
    let mut tasks = vec![];
    let client = RawClient::connect(address, STREAM).await?;
    for _ in 0..streams {
        let (mut client, first, rest, answered) =
            (client.clone(), first.clone(), rest.clone(), answered.clone());
        tasks.push(tokio::spawn(async move {
            let (send, mut receive) = mpsc::channel::<Bytes>(under_way);
            let messages = tokio_stream_of(move |cx| receive.poll_recv(cx));
            let mut answers = client.stream(messages).await?;
            let _ = send.send(first).await;
            for _ in 1..under_way {
                let _ = send.send(rest.clone()).await;
            }
            while Instant::now() < end {
                next(&mut answers).await?;
                answered.fetch_add(1, Ordering::Relaxed);
                let _ = send.send(rest.clone()).await;
            }
            Ok::<(), tonic::Status>(())
        }));
    }
    for task in tasks {
        task.await??;
    }
    Ok(answered.load(Ordering::Relaxed))
}

fn tokio_stream_of<T>(
    poll: impl FnMut(&mut std::task::Context<'_>) -> std::task::Poll<Option<T>> + Send + Unpin + 'static,
) -> impl tokio_stream::Stream<Item = T> + Send {
    struct Polled<F>(F);
    impl<T, F: FnMut(&mut std::task::Context<'_>) -> std::task::Poll<Option<T>> + Unpin> tokio_stream::Stream
        for Polled<F>
    {
        type Item = T;
        fn poll_next(
            mut self: std::pin::Pin<&mut Self>,
            cx: &mut std::task::Context<'_>,
        ) -> std::task::Poll<Option<T>> {
            (self.0)(cx)
        }
    }
    Polled(poll)
}
