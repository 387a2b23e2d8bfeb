"""A Dask cluster on the loopback interface with TLS: a scheduler and workers, each a process of its own."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

PATIENCE_S = 120.0


@dataclass
class Loopback:
    """A running cluster; workers: their processes, in the order in which they were started."""

    folder: Path
    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def tls(self) -> dict[str, str]:
        """Return the certificate files, which client, scheduler and workers share."""
        return {name: str(self.folder / f"{name}.pem") for name in ("ca", "cert", "key")}

    @property
    def options(self) -> list[str]:
        """Return the options of `bodycheck run` that use this cluster."""
        ca, cert, key = self.tls.values()
        return ["--cluster", self.address, "--tls-ca-file", ca, "--tls-cert", cert, "--tls-key", key]

    def add_worker(self, *words: str) -> None:
        """Start a worker with one thread, and wait until it has joined."""
        name = f"worker-{len(self.workers)}"
        log = self.folder / f"{name}.log"
        own = ["--no-nanny", "--nthreads", "1", "--name", name, "--local-directory", str(self.folder / name)]
        self.workers.append(_started(["worker", self.address, *own, *_tls(self.folder), *words], log))
        _wait_for(log, b"Registered to", self.workers[-1])


@contextmanager
def loopback_cluster(folder: Path, workers: Sequence[Sequence[str]]) -> Iterator[Loopback]:
    """Run a cluster within a with block, with one worker per list of further options."""
    _make_certificates(folder)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    log = folder / "scheduler.log"
    words = ["scheduler", "--host", "127.0.0.1", "--port", str(port), "--protocol", "tls", *_tls(folder)]
    cluster = Loopback(folder, f"tls://127.0.0.1:{port}", _started(words, log))
    try:
        _wait_for(log, b"Scheduler at", cluster.scheduler)
        for options in workers:
            cluster.add_worker(*options)
        yield cluster
    finally:
        for process in [*cluster.workers, cluster.scheduler]:
            process.send_signal(signal.SIGCONT)
            process.kill()
            process.wait()


def _tls(folder: Path) -> list[str]:
    files = {name: str(folder / f"{name}.pem") for name in ("ca", "cert", "key")}
    options = ["--tls-ca-file", files["ca"], "--tls-cert", files["cert"], "--tls-key", files["key"]]
    return [*options, "--no-dashboard"]


def _started(words: Sequence[str], log: Path) -> subprocess.Popen[bytes]:
    with log.open("wb") as output:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", *words],
            stdout=output,
            stderr=output,
            env={**os.environ, "PYTHONWARNINGS": "ignore"},
        )


def _wait_for(log: Path, words: bytes, process: subprocess.Popen[bytes]) -> None:
    end = time.monotonic() + PATIENCE_S
    while words not in log.read_bytes():
        if process.poll() is not None or time.monotonic() > end:
            raise RuntimeError(log.read_text())
        time.sleep(0.05)


def _make_certificates(folder: Path) -> None:
    """Write ca.pem, cert.pem and key.pem, valid for a week."""
    key = ["-newkey", "rsa:2048", "-nodes", "-days", "7", "-subj"]
    authority = ["-keyout", "ca-key.pem", "-out", "ca.pem"]
    _openssl(folder, "req", "-x509", *key, "/CN=bodycheck-test-authority", *authority)
    signed = ["-CA", "ca.pem", "-CAkey", "ca-key.pem", "-keyout", "key.pem", "-out", "cert.pem"]
    _openssl(folder, "req", "-x509", *key, "/CN=127.0.0.1", *signed)


def _openssl(folder: Path, *words: str) -> None:
    subprocess.run(["openssl", *words], cwd=folder, check=True, capture_output=True)
