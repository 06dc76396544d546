"""The client's TLS and tokens, against a server that requires them."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import grpc
import numpy as np
import pytest
import trustme

import hullcast
from hullcast._serve import find_binary

CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
NO_PROXY = [("grpc.enable_http_proxy", 0)]


@dataclass
class Secured:
    """A server with TLS and perhaps tokens, and the files that a client needs for it."""

    target: str
    roots: bytes
    key: bytes
    certificate: bytes
    directory: Path

    def credentials(self) -> grpc.ChannelCredentials:
        return grpc.ssl_channel_credentials(self.roots, self.key, self.certificate)


def _start(directory: Path, *arguments: str) -> tuple[subprocess.Popen[str], str]:
    authority = trustme.CA()
    own = authority.issue_cert("localhost")
    own.private_key_pem.write_to_path(directory / "key.pem")
    with open(directory / "certificate.pem", "wb") as file:
        file.writelines(blob.bytes() for blob in own.cert_chain_pems)
    authority.cert_pem.write_to_path(directory / "ca.pem")
    client = authority.issue_cert("client@localhost")
    (directory / "client.pem").write_bytes(b"".join(b.bytes() for b in client.cert_chain_pems))
    client.private_key_pem.write_to_path(directory / "client.key")
    command = [find_binary(), "serve", "--listen", "localhost:0", "--until-stdin-closes"]
    command += ["--store", str(directory / "store"), "--reload-seconds", "0.05"]
    command += ["--tls-certificate", str(directory / "certificate.pem")]
    command += ["--tls-key", str(directory / "key.pem"), *arguments]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    assert process.stdout is not None
    address = process.stdout.readline().strip().removeprefix("listening on ")
    return process, "localhost:" + address.rpartition(":")[2]


@pytest.fixture
def tls(tmp_path: Path) -> Iterator[Secured]:
    yield from _secured(tmp_path)


@pytest.fixture
def guarded(tmp_path: Path) -> Iterator[Secured]:
    (tmp_path / "query").write_text("reader\n")
    (tmp_path / "register").write_text("writer\n")
    yield from _secured(
        tmp_path,
        "--tls-client-ca",
        str(tmp_path / "ca.pem"),
        "--query-tokens",
        str(tmp_path / "query"),
        "--register-tokens",
        str(tmp_path / "register"),
    )


def _secured(directory: Path, *arguments: str) -> Iterator[Secured]:
    process, target = _start(directory, *arguments)
    read = [(directory / name).read_bytes() for name in ("ca.pem", "client.key", "client.pem")]
    try:
        yield Secured(target, *read, directory)
    finally:
        process.communicate()
    assert process.returncode == 0


def test_roots_are_given_as_bytes_path_or_credentials(tls: Secured) -> None:
    """Catches a form of `tls` that does not connect, and a client that trusts any server."""
    for roots in (tls.roots, tls.directory / "ca.pem", grpc.ssl_channel_credentials(tls.roots)):
        with hullcast.connect(tls.target, tls=roots, options=NO_PROXY) as client:
            assert client.register([CUBE])[0].vertex_count == 8
    for wrong in (True, None, trustme.CA().cert_pem.bytes()):
        with (
            hullcast.connect(tls.target, tls=wrong, timeout=1, options=NO_PROXY) as client,
            pytest.raises((hullcast.Unavailable, hullcast.DeadlineExceeded)),
        ):
            client.register([CUBE])


def test_a_client_certificate_and_a_token_are_asked_for(guarded: Secured) -> None:
    """Catches a token that is not sent with every call, and a wrong role."""

    def connect(token: str | None) -> hullcast.Client:
        return hullcast.connect(
            guarded.target, tls=guarded.credentials(), token=token, options=NO_PROXY
        )

    with connect("writer") as writer, connect("reader") as reader:
        hulls = writer.register([CUBE])
        scene = hullcast.Scene(
            hulls, [[0, 0, 0], [0, 0, 0.9]], [[0, 0, 0, 1]] * 2, body_hulls=[0, 0]
        )
        assert reader.query(scene, [[0, 1]]).outcome[0] == writer.query(scene, [[0, 1]]).outcome[0]
        with pytest.raises(hullcast.Unauthenticated) as refused:
            reader.register([2 * CUBE])
        assert refused.value.reason == "TOKEN_MAY_NOT"
    for token, reason in ((None, "MISSING_TOKEN"), ("guess", "UNKNOWN_TOKEN")):
        with connect(token) as nobody, pytest.raises(hullcast.Unauthenticated) as refused:
            nobody.query(scene, [[0, 1]])
        assert refused.value.reason == reason
        assert "token=" in refused.value.message  # the remedy
    with (
        hullcast.connect(
            guarded.target, tls=guarded.roots, token="writer", timeout=1, options=NO_PROXY
        ) as uncertified,
        pytest.raises((hullcast.Unavailable, hullcast.DeadlineExceeded)),
    ):
        uncertified.register([CUBE])


def test_the_command_line_has_the_same(guarded: Secured) -> None:
    """Catches a certificate or token of `hullcast load` that does not reach the server."""
    (guarded.directory / "token").write_text("writer\n")
    command = [find_binary(), "load", "--remote", f"https://{guarded.target}", "--count", "4"]
    command += ["--pairs", "16", "--duration", "60"]
    files = {"tls-ca": "ca.pem", "tls-certificate": "client.pem", "tls-key": "client.key"}
    for option, name in files.items():
        command += [f"--{option}", str(guarded.directory / name)]
    refused = subprocess.run(command, capture_output=True, text=True)
    assert refused.returncode == 5
    assert "MISSING_TOKEN" in refused.stderr
    command += ["--token-file", str(guarded.directory / "token")]
    assert subprocess.run(command, capture_output=True).returncode == 0
