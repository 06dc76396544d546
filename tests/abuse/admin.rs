//! Attacks on the admin port (metrics and health for the operator).

use std::io;

use futures_util::future::join_all;
use tokio::{io::AsyncWriteExt, net::TcpStream};

use crate::support::{
    arena::{ATTACKER, Arena},
    dial,
};

attacks! {
    /// Catches connections, headers and answers of the admin port that no limit covers.
    admin: "connections to the admin port that send nothing or too much, or read nothing" => admin;
}

async fn admin(arena: &Arena) {
    arena.begin().await;
    let said = [
        Vec::new(),
        b"GET /metrics HTTP/1.1\r\nhost: ".to_vec(),
        [b"GET /metrics HTTP/1.1\r\nx: ".to_vec(), vec![b'x'; 10 << 20]].concat(),
        b"GET /metrics HTTP/1.1\r\nhost: here\r\n\r\n".repeat(10_000),
        [b"POST / HTTP/1.1\r\nhost: here\r\ncontent-length: 9999999999\r\n\r\n".to_vec(), vec![0; 10 << 20]]
            .concat(),
        [
            b"POST / HTTP/1.1\r\nhost: here\r\ntransfer-encoding: chunked\r\n\r\n".to_vec(),
            b"1\r\nx\r\n".repeat(1 << 20),
        ]
        .concat(),
    ];
    let attackers = (0..arena.size().of(500)).map(async |i: usize| {
        let stream = dial::tcp(ATTACKER, arena.server.admin).await?;
        let stream = wait_longer(stream, &said[i % said.len()]).await?;
        Ok::<TcpStream, io::Error>(stream)
    });
    let held = join_all(attackers).await;
    arena.bystander_answered(arena.size().of(400)).await;
    drop(held);
}

/// Writes `said` for at most 500 ms: a server that defends itself stops reading before the end.
async fn wait_longer(mut stream: TcpStream, said: &[u8]) -> io::Result<TcpStream> {
    let time = std::time::Duration::from_millis(500);
    let _ = tokio::time::timeout(time, stream.write_all(said)).await;
    Ok(stream)
}
