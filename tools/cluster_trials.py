"""Compare runs in shards and on a Dask cluster, with and without lost workers, with one run on this machine.

    python tools/cluster_trials.py smoke --engine mujoco,dart,reference

Starts a scheduler and three workers with TLS on the loopback interface. Compares with one run, cell by cell:
the merged tables of 8 shards, a cluster run, and a cluster run of which one worker is killed and another one
stops answering. Prints how many answers the journal of the last one has and how many of them twice, and the
additional time per case in batches through one worker relative to a run without the cluster. Exit status 1
if a cell differs, or if an answer is missing or present twice.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import wait
from pathlib import Path

import pandas as pd
from trials import command

from bodycheck._util.shard import Shard
from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case
from bodycheck.adapters.workers import case_messages
from bodycheck.adapters.workers.engine_pool import EnginePool, announced
from bodycheck.adapters.workers.executors import CaseRequest, answer_case
from bodycheck.reports.cache.disk_cache import Entry
from bodycheck.runs.cluster import TlsFiles, connected
from bodycheck.runs.directory import partial_of
from bodycheck.scenarios.library import load_scenario
from tests.helpers.dask_cluster import Loopback, loopback_cluster
from tests.helpers.scenario_texts import comparable_tables

SHARDS = 8
_CASES, _REPEATS = 400, 5


def differing(one: Path, other: Path) -> int:
    """Return the number of cells in which the tables of two runs differ, except speeds and the run's id."""
    cells, others = 0, comparable_tables(other)
    for name, a in comparable_tables(one).items():
        b = others[name]
        cells += a.size + b.size if a.shape != b.shape else int((a != b).to_numpy().sum())
    return cells


def bodycheck(*words: str) -> None:
    """Run a command to its end."""
    subprocess.run([sys.executable, "-m", "bodycheck", *words], check=True, stdout=subprocess.DEVNULL)


def run_and_lose_two(words: list[str], out: Path, cluster: Loopback, answers: int) -> Path:
    """Run; after this many answers kill one worker and stop another. Return a copy of the journal."""
    journal, kept = partial_of(out) / "journal", out.with_name("journal")
    running = subprocess.Popen(
        [sys.executable, "-m", "bodycheck", *words, "--out", str(out)], stdout=subprocess.DEVNULL
    )
    while not journal.exists() or journal.read_bytes().count(b"\n") < answers:
        if running.poll() is not None:
            raise RuntimeError("the run ended before its workers were lost")
        time.sleep(0.005)
    os.link(journal, kept)
    cluster.workers[1].send_signal(signal.SIGKILL)
    cluster.workers[2].send_signal(signal.SIGSTOP)
    if running.wait() != 0:
        raise RuntimeError("the run failed")
    return kept


def answered(journal: Path) -> list[str]:
    """Return the keys of the answers in a journal."""
    entries = [Entry.read(line) for line in journal.read_bytes().splitlines(keepends=True)]
    return [entry.key for entry in entries if entry is not None]


def overhead_ms(cluster: Loopback) -> tuple[float, float]:
    """Return the milliseconds per case without the cluster, and the additional ones through it."""
    engine = announced(["reference"])["reference"]
    assert not isinstance(engine, str)
    case = Case(load_scenario("free-flight").scene, "rk4", Setting(dt_s=1e-3))
    request = {"do": "record", "case": case_messages.case_message(case)}
    requested = CaseRequest("reference", engine.version, request, 120.0)
    here, there = [], []
    engine_pool = EnginePool()
    tls = cluster.tls
    with connected(cluster.address, TlsFiles(tls["ca"], tls["cert"], tls["key"]), speed=False) as connection:
        submit = connection.executor.submit
        wait([submit(answer_case, requested) for _ in range(_CASES)])  # starts the engines
        engine_pool.ask("reference", request, 120.0)
        for _ in range(_REPEATS):
            begin = time.perf_counter()
            for _ in range(_CASES):
                engine_pool.ask("reference", request, 120.0)
            here.append(time.perf_counter() - begin)
            begin = time.perf_counter()
            done = [submit(answer_case, requested) for _ in range(_CASES)]
            assert all(future.result()["outcome"] == "ok" for future in done)
            there.append(time.perf_counter() - begin)
    engine_pool.close()
    return 1e3 * min(here) / _CASES, 1e3 * (min(there) - min(here)) / _CASES


def trials(words: list[str], folder: Path) -> bool:
    """Run all trials, print their figures, and return whether nothing differs."""
    whole = folder / "whole"
    begin = time.perf_counter()
    bodycheck(*words, "--out", str(whole))
    here_s = time.perf_counter() - begin
    rows = len(pd.read_csv(whole / "results.csv"))
    print(f"one run: {rows} cases in {here_s:.1f} s", flush=True)
    parts = [folder / f"part-{k}" for k in range(1, SHARDS + 1)]
    for k, part in enumerate(parts, start=1):
        bodycheck(*words, "--shard", str(Shard(k, SHARDS)), "--out", str(part))
    bodycheck("merge", *map(str, parts), "--out", str(folder / "merged"))
    found = {f"{SHARDS} merged shards": differing(whole, folder / "merged")}
    certificates = folder / "cluster"
    certificates.mkdir()
    with loopback_cluster(certificates, [()] * 3) as cluster:
        for name in ("the cluster, first run", "the cluster"):
            out = folder / name.replace(" ", "-")
            begin = time.perf_counter()
            bodycheck(*words, *cluster.options, "--out", str(out))
            print(f"{name}: {time.perf_counter() - begin:.1f} s", flush=True)
            found[name] = differing(whole, out)
    shutil.rmtree(certificates)
    certificates.mkdir()
    with loopback_cluster(certificates, [()] * 3) as cluster:
        lost = folder / "lost"
        begin = time.perf_counter()
        journal = run_and_lose_two([*words, *cluster.options], lost, cluster, rows // 3)
        print(f"one worker killed, one stopped: {time.perf_counter() - begin:.1f} s", flush=True)
        found["one worker killed, one stopped"] = differing(whole, lost)
        keys = answered(journal)
        twice = len(keys) - len(set(keys))
        print(f"answers in its journal: {len(keys)}, twice: {twice}")
    shutil.rmtree(certificates)
    certificates.mkdir()
    with loopback_cluster(certificates, [()]) as cluster:
        alone, more = overhead_ms(cluster)
        print(f"a case takes {alone:.2f} ms here, and {more:.2f} ms more through one worker of the cluster")
    for name, cells in found.items():
        print(f"{name}: {cells} cells differ")
    return not any(found.values()) and not twice


def main(*scenarios: str, engine: str = "mujoco,dart,reference") -> bool:
    """Print the figures; return whether something differs."""
    words = ["run", *(scenarios or ("smoke",)), "--engine", engine, "--no-speed", "--fresh", "--quiet"]
    with tempfile.TemporaryDirectory() as folder:
        return not trials(words, Path(folder))


if __name__ == "__main__":
    command(main)
