"""Check that a reader accepts or refuses any file: no traceback, no hang, no unlimited memory.

    python tools/reader_trials.py --trials 20000 --seed 1

Damages valid files of every kind that bodycheck reads, about half of them by their grammar, so that the
damage passes the first parser, and reads each. Prints the figures by reader. Exit status 1 if a reader
raised anything but bodycheck's own errors or took more than 10 s, or the process held more than 500 MB.
"""

from __future__ import annotations

import json
import random
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from trials import command

import bodycheck
from bodycheck._util.errors import BodycheckError, InputError
from bodycheck._util.untrusted import LONGEST_LINE, printable_lines, read_json
from bodycheck.adapters.contract import Build, Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.workers import protocol, received_messages
from bodycheck.audit.audit_run import AuditOptions, audit
from bodycheck.recordings.column_map import ColumnMap, read_map
from bodycheck.recordings.conversion import recorded_motion
from bodycheck.reference_impl.kernels.cache_files import _content, _DamagedError
from bodycheck.reports.cache.disk_cache import Cache, Entry
from bodycheck.reports.cache.journal import Journal
from bodycheck.reports.comparison.compare import compare
from bodycheck.reports.document import markdown
from bodycheck.reports.gates.gate import read_gates
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import baseline_of, readable_runs, seal_run
from bodycheck.reports.history.queries import CHANGES, QUERIED, query
from bodycheck.reports.run_files.run_reader import read_run, read_tables
from bodycheck.reports.run_files.tables import as_parquet
from bodycheck.reports.run_files.trajectory_files import read_arrays
from bodycheck.reports.summary.advice import settings_within
from bodycheck.reports.summary.error_curve import curves_of
from bodycheck.reports.summary.sentences import run_document
from bodycheck.runs.directory import _describe, _description
from bodycheck.runs.selection import select
from bodycheck.scenarios.library import load_scenario
from bodycheck.scenarios.mesh_files import open_mesh, parse_mesh
from bodycheck.scenarios.reader import read_members, read_trees
from tests.helpers.child_process import ChildResult, run_in_child
from tests.helpers.file_mutations import (
    Mutation,
    any_bytes,
    csv_cell,
    json_value,
    mcap_message,
    npz_member,
    parquet_column,
    passes,
    token,
    toml_line,
)
from tests.helpers.html_page import report_page
from tests.helpers.model_texts import mutated, random_mjcf, random_urdf, sdf_of
from tests.helpers.nightly_runs import store_nightly_runs, unchanged
from tests.helpers.scenario_texts import SCENARIO
from tests.recordings.test_conversion import write_mcap
from tests.scenarios.test_mesh_files import ascii_ply, ascii_stl, binary_ply, binary_stl, obj
from tests.scenarios.test_mesh_inputs import ascii_cube
from tests.scenarios.test_mesh_scenes import dae, glb, model_3mf, packed

LONGEST_S, MAX_MEGABYTES, BATCH = 10.0, 500.0, 25

GATES = """[[gate]]
scenario = "mine*"
engine = "reference"
method = "rk4"
dt_s = 1e-2
measure = "orientation_error_rad"
upper = 1e-9
floor = 1e-14
reason = "fourth order"

[[gate]]
measure = "verdict"
equals = "converges"
reason = "it does"
"""


@dataclass(frozen=True)
class Reader:
    """A valid file and its reader: `read` is given the path of the damaged file.

    kind: of the grammar, for `passes`; weight: how often it is tried.
    """

    name: str
    file: Path
    read: Callable[[Path], Any]
    kind: str
    by_grammar: Mutation
    weight: float = 1.0


def all_readers(sound: Path) -> list[Reader]:
    """Write a valid file of every kind, and return its readers."""
    (sound / "mine.toml").write_text(SCENARIO)
    run = bodycheck.run([sound / "mine.toml"], engines=["reference:m1", "reference:rk4"], jobs=1)
    bodycheck.write_run(run, sound / "run")
    store_nightly_runs(run, sound / "history", [unchanged, unchanged])
    found = [*_inputs(sound), *_trajectories(sound), *_run_files(sound), *_night_files(sound, run.manifest)]
    return [*found, *_models(sound), *_messages(sound), *_caches(sound)]


def _inputs(sound: Path) -> list[Reader]:
    """Return the readers of scenarios, gates, meshes, and the request of a run that was stopped."""
    library = Path(bodycheck.__file__).parent / "scenarios/library"
    whole = "\n".join((library / f"{name}.toml").read_text() for name in ("spring-pendulum",))
    (sound / "rich.toml").write_text(whole)
    shutil.copy(library / "trees/free-ball.toml", sound / "tree.toml")
    (sound / "gates.toml").write_text(GATES)
    meshes: dict[str, str | bytes] = {
        "a.stl": ascii_stl(),
        "b.stl": binary_stl(),
        "c.obj": obj(),
        "d.ply": ascii_ply(),
        "e.ply": binary_ply("<"),
        "f.off": ascii_cube("off"),
        "g.glb": glb(),
        "h.3mf": packed(model_3mf()),
        "i.dae": dae(),
        "j.obj": obj().encode("utf-16"),
    }
    for name, content in meshes.items():
        (sound / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    from bodycheck.runs.manifest import Identity
    from bodycheck.runs.request import Request

    selection = select([sound / "mine.toml"], ["reference:m1"])
    _describe(sound / "out.partial", Request(dt_s=[0.01]), Identity.new(), selection, sound / "out")
    return [
        Reader("scenario", sound / "mine.toml", read_members, "toml", toml_line, 2.0),
        Reader("scenario with loads", sound / "rich.toml", read_members, "toml", toml_line, 2.0),
        Reader("tree", sound / "tree.toml", read_trees, "toml", toml_line, 2.0),
        Reader("gates", sound / "gates.toml", read_gates, "toml", toml_line, 2.0),
        *(Reader(f"mesh {name}", sound / name, _mesh, "mesh", token) for name in meshes),
        Reader("request.json", sound / "out.partial/request.json", _description, "json", json_value),
    ]


def _mesh(path: Path) -> None:
    with open_mesh(path) as file:
        parse_mesh(path, file)


def _models(sound: Path) -> list[Reader]:
    """Return the readers of model files, which must name the file in one line."""
    text = random_urdf(np.random.default_rng(1))
    texts = {"URDF": text, "SDFormat": sdf_of(text), "MJCF": random_mjcf(np.random.default_rng(1))}

    def model(path: Path) -> None:
        try:
            audit(path, AuditOptions(engines=[], spins=False))
        except InputError as error:
            if "\n" in str(error) or str(path) not in str(error):
                raise AssertionError(f"unclear: {error}") from None
            raise

    for name, content in texts.items():
        (sound / f"{name}.xml").write_text(content)
    return [Reader(f"model {name}", sound / f"{name}.xml", model, "model", mutated) for name in texts]


def _trajectories(sound: Path) -> list[Reader]:
    """Return the readers that `judge` uses."""
    npz = next((sound / "run/trajectories").rglob("reference_m1*.npz"))
    with np.load(npz) as arrays:
        rows = np.column_stack([arrays["t_s"], arrays["quaternion"]])
    lines = ["t_s,qw,qx,qy,qz", *(",".join(map(repr, row)) for row in rows.tolist())]
    (sound / "judged.csv").write_text("\n".join(lines) + "\n")
    shutil.copy(npz, sound / "judged.npz")
    for suffix in (".zip", ".gz", ".tar", ".xz"):
        shutil.copy(sound / "judged.csv", sound / f"judged.csv{suffix}")
    mine = load_scenario(sound / "mine.toml")
    cache = Cache.default()

    def judged(path: Path) -> None:
        from bodycheck.recordings.judge import judge_files, read_files

        judge_files([path], read_files([path], ColumnMap(), None), mine, "mine.toml", cache, None)

    return [
        Reader("judged .csv", sound / "judged.csv", judged, "csv", csv_cell, 0.2),
        Reader("judged .npz", sound / "judged.npz", judged, "npz", npz_member, 0.2),
        *_recordings(sound),
        Reader("trajectory .npz", sound / "judged.npz", read_arrays, "npz", npz_member, 1.0),
        *(
            Reader(f"judged .csv{suffix}", sound / f"judged.csv{suffix}", _recorded, "csv", csv_cell, 0.3)
            for suffix in (".zip", ".gz", ".tar", ".xz")
        ),
    ]


def _recorded(path: Path) -> None:
    recorded_motion(path, ColumnMap())


def _recordings(sound: Path) -> list[Reader]:
    """Return the readers of recordings in every format without an extra package, and of a map."""
    table = pd.read_csv(sound / "judged.csv")
    (sound / "judged.parquet").write_bytes(as_parquet(table))
    (sound / "judged.jsonl").write_text(json.dumps(table.to_dict("records")[0]) + "\n")
    mcap = write_mcap({name: table[name].to_numpy() for name in table}, sound / "judged")
    (sound / "map.toml").write_text('t_s = "2*t_s"\nqw = "-qw"\nworld = "NED to ENU"\nignore = ["a*"]\n')

    (sound / "mcap.toml").write_text('ignore = ["log_time_s"]\n')

    def without_log_times(path: Path) -> None:
        recorded_motion(path, read_map([sound / "mcap.toml"]))

    def mapped(path: Path) -> None:
        recorded_motion(sound / "judged.csv", read_map([path]))

    return [
        Reader("recording .csv", sound / "judged.csv", _recorded, "csv", csv_cell, 2.0),
        Reader("recording .jsonl", sound / "judged.jsonl", _recorded, "json", json_value),
        Reader("recording .parquet", sound / "judged.parquet", _recorded, "parquet", parquet_column),
        Reader("recording .mcap", mcap, without_log_times, "mcap", mcap_message),
        Reader("column map", sound / "map.toml", mapped, "toml", toml_line),
    ]


def _run_files(sound: Path) -> list[Reader]:
    """Return the readers of a stored run, each with one damaged file among the valid ones."""
    other = read_tables(sound / "run")

    def tables_of(path: Path) -> None:
        read_tables(path.parent)

    def questions(path: Path) -> None:
        tables = read_tables(path.parent)
        compare(other, tables)
        compare(tables, other)
        markdown(run_document(tables))
        curves = curves_of(tables, "orientation_error_rad")
        settings_within(curves, 1e-3, list(tables.manifest["scenarios"]))

    def page(path: Path) -> None:
        folder = next(parent for parent in path.parents if (parent / "methods.csv").exists())
        report_page(read_run(folder, allow_code=False, cache=Cache.default()))

    npz = next((sound / "run/trajectories").rglob("reference_m1*.npz"))
    return [
        Reader("manifest.json", sound / "run/manifest.json", tables_of, "json", json_value, 2.0),
        Reader("results.csv", sound / "run/results.csv", tables_of, "csv", csv_cell, 2.0),
        Reader("methods.csv", sound / "run/methods.csv", tables_of, "csv", csv_cell),
        Reader("stability.csv", sound / "run/stability.csv", tables_of, "csv", csv_cell),
        Reader("questions, manifest.json", sound / "run/manifest.json", questions, "json", json_value, 0.2),
        Reader("questions, results.csv", sound / "run/results.csv", questions, "csv", csv_cell, 0.3),
        Reader("questions, methods.csv", sound / "run/methods.csv", questions, "csv", csv_cell, 0.2),
        Reader("questions, stability.csv", sound / "run/stability.csv", questions, "csv", csv_cell, 0.1),
        Reader("page of manifest.json", sound / "run/manifest.json", page, "json", json_value, 0.05),
        Reader("page of results.csv", sound / "run/results.csv", page, "csv", csv_cell, 0.05),
        Reader("page of read_back.json", sound / "run/read_back.json", page, "json", json_value, 0.05),
        Reader("page of a trajectory", npz, page, "npz", npz_member, 0.05),
    ]


def _night_files(sound: Path, manifest: dict[str, Any]) -> list[Reader]:
    """Return the readers of a past nightly run, as it was stored and sealed again after the damage."""
    shutil.copytree(sound / "history", sound / "again")
    newest = {**manifest, "run_id": "20991231T000000Z-ffffff"}

    def damaged(path: Path) -> None:
        history = History(path.parents[1])
        found = baseline_of(history, newest)
        readable, _ = readable_runs(history.runs(), tuple(QUERIED))
        for table in ("nights", "results", CHANGES.name):
            query(readable, f"SELECT * FROM {table}")
        if not found.runs:
            raise AssertionError("the sound night was left out too")

    def sealed_again(path: Path) -> None:
        if isinstance(read_json(path.with_name("night.json")), dict):
            seal_run(path.parent)
        damaged(path)

    run = History(sound / "history").runs()[-1].name
    stored, again = sound / "history" / run, sound / "again" / run
    return [
        Reader("night.json", stored / "night.json", damaged, "json", json_value, 0.07),
        Reader("results.csv of a night", stored / "results.csv", damaged, "csv", csv_cell, 0.07),
        Reader("night.json, sealed again", again / "night.json", sealed_again, "json", json_value, 0.2),
        Reader("manifest.json, sealed again", again / "manifest.json", sealed_again, "json", json_value, 0.2),
        Reader("results.csv, sealed again", again / "results.csv", sealed_again, "csv", csv_cell, 0.2),
        Reader("changes.csv, sealed again", again / "changes.csv", sealed_again, "csv", csv_cell, 0.2),
    ]


def _messages(sound: Path) -> list[Reader]:
    """Return the readers of a worker's messages, with one file per message."""
    scene = load_scenario(sound / "mine.toml").scene
    reference = Reference()
    case = Case(scene, "m1", Setting(dt_s=0.01))
    messages = {
        "announcement": protocol.announcement(reference, Build()),
        "answer": protocol.answer_message(record(reference, case)),
        "lap": {"outcome": "ok", "cpu_s": 1.5},
        "search": {"outcome": "ok", "message": "", "stable_s": 0.1, "unstable_s": 0.2, "reason": "x"},
    }
    messages["read_back"] = messages["answer"]["read_back"]
    for name, message in messages.items():
        (sound / f"{name}.message").write_bytes(protocol.line_of(message))

    def of(read: Callable[[Any], Any]) -> Callable[[Path], None]:
        def through(path: Path) -> None:
            try:
                read(protocol.message_of(path.read_bytes()))
            except ValueError as error:
                raise BodycheckError(str(error)) from None

        return through

    def answered(message: Any) -> None:
        answer = received_messages.answer_of(message, scene.sample_times)
        Entry.of("key", received_messages.stored_part(message, answer))

    readers: dict[str, Callable[[Any], Any]] = {
        "announcement": received_messages.engine_of,
        "answer": answered,
        "lap": received_messages.lap_of,
        "search": received_messages.stable_step_of,
        "read_back": received_messages.read_back_of,
    }
    return [
        Reader(f"message: {name}", sound / f"{name}.message", of(read), "json", json_value, 2.0)
        for name, read in readers.items()
    ]


def _caches(sound: Path) -> list[Reader]:
    """Return the readers of cached results, of which nothing damaged may be used."""
    cache = Cache(sound / "cache")
    key = "ab" + 62 * "0"
    cache.put(key, {"value": [1, 2, 3]})
    with Journal(sound / "journal") as journal:
        for name in ("a", "b", "c"):
            journal.put(name, {"value": name})
    import hashlib
    import pickle

    data = pickle.dumps(("0.61", "stamp", {}))
    (sound / "kernel.nbi").write_bytes(hashlib.sha256(data).digest() + data)

    def cached(path: Path) -> None:
        if Cache(path.parents[1]).get(key) not in (None, {"value": [1, 2, 3]}):
            raise AssertionError("a damaged line was believed")

    def journalled(path: Path) -> None:
        with Journal(path) as opened:
            if any(opened.get(name) not in (None, {"value": name}) for name in "abc"):
                raise AssertionError("a damaged line was believed")

    def kernel(path: Path) -> None:
        try:
            if _content(path) != ("0.61", "stamp", {}):
                raise AssertionError("a damaged kernel was believed")
        except _DamagedError as error:
            raise BodycheckError(str(error)) from None

    return [
        Reader("cache", sound / "cache" / key[:2] / key[2:], cached, "sealed", any_bytes),
        Reader("journal", sound / "journal", journalled, "sealed", any_bytes),
        Reader("kernel", sound / "kernel.nbi", kernel, "sealed", any_bytes),
    ]


@dataclass
class Tried:
    """The result of one mutation: accepted, refused, or a fault with its traceback."""

    reader: str
    ending: str
    passed: bool
    seconds: float
    seed: str
    fault: str = ""


class Hang(BaseException):
    """A reader that exceeded its time limit."""


def _late(*_: object) -> None:
    raise Hang(f"more than {LONGEST_S:g} s")


def tried(reader: Reader, folder: Path, sound: Path, seed: str) -> Tried:
    """Damage a copy of the reader's file, read it, and restore the valid content."""
    dice = random.Random(seed)
    content = reader.file.read_bytes()
    damaged = (reader.by_grammar if dice.random() < 0.6 else any_bytes)(content, dice)
    path = folder / reader.file.relative_to(sound)
    begin = time.monotonic()
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    ending, fault = "accepted", ""
    try:
        path.write_bytes(damaged)
        reader.read(path)
    except BodycheckError as error:
        ending = "refused"
        lines = printable_lines(str(error)).split("\n")
        if not str(error) or any(len(line) > LONGEST_LINE for line in lines):
            ending, fault = "fault", f"unclear: {lines}"
    except BaseException as error:  # noqa: BLE001 - the trial searches for any exception
        import traceback

        ending = "hang" if isinstance(error, Hang) else "fault"
        fault = "".join(traceback.format_exception(error))[-3000:]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        path.write_bytes(content)
    seconds = time.monotonic() - begin
    return Tried(reader.name, ending, passes(reader.kind, damaged), seconds, seed, fault)


def _together(batch: list[tuple[Reader, str]], folder: Path, sound: Path) -> ChildResult:
    """Try some mutations in a separate child process."""
    return run_in_child(
        lambda: [tried(reader, folder, sound, seed) for reader, seed in batch], 2 * LONGEST_S * len(batch)
    )


def main(trials: int = 20_000, seed: int = 1, only: str | None = None) -> bool:
    """Run the trials, with one reader only if it is named; return whether one failed."""
    signal.signal(signal.SIGALRM, _late)
    begin = time.monotonic()
    results: list[Tried] = []
    megabytes = 0.0
    with tempfile.TemporaryDirectory(prefix="reader-trials-") as place:
        sound, folder = Path(place, "sound"), Path(place, "damaged")
        sound.mkdir()
        readers = [one for one in all_readers(sound) if only in (None, one.name)]
        shutil.copytree(sound, folder)
        intact = run_in_child(
            lambda: [one.read(folder / one.file.relative_to(sound)) for one in readers], 600.0
        )
        if intact.error is not None:  # includes compiling the kernels, which takes longer than a reader may
            raise RuntimeError(f"an intact file is refused: {intact.error}")
        total = sum(reader.weight for reader in readers)
        seeds = [
            (reader, f"{seed}/{reader.name}/{k}")
            for reader in readers
            for k in range(round(trials * reader.weight / total))
        ]
        while seeds:
            batch, seeds = seeds[:BATCH], seeds[BATCH:]
            ended = _together(batch, folder, sound)
            megabytes = max(megabytes, ended.megabytes)
            if ended.error is None:
                results += ended.value
                continue
            for one in batch:  # find out which of them failed
                alone = _together([one], folder, sound)
                died = Tried(one[0].name, "died", True, alone.seconds, one[1], str(alone.error))
                results += [died] if alone.error is not None else alone.value
                megabytes = max(megabytes, alone.megabytes)
    return report(results, megabytes, time.monotonic() - begin, seed)


def report(results: list[Tried], megabytes: float, seconds: float, seed: int) -> bool:
    """Print one line per reader and the totals; return whether one failed."""
    heads = f"{'tried':>6s} {'passed':>7s} {'taken':>6s} {'refused':>8s} {'faults':>7s} {'slowest':>8s}"
    print(f"{'reader':26s} {heads}")
    for name in dict.fromkeys(one.reader for one in results):
        mine = [one for one in results if one.reader == name]
        counts = Counter(one.ending for one in mine)
        taken, refused = counts["accepted"], counts["refused"]
        slowest, passed = max(one.seconds for one in mine), sum(one.passed for one in mine)
        figures = f"{len(mine):6d} {passed:7d} {taken:6d} {refused:8d} {len(mine) - taken - refused:7d}"
        print(f"{name:26s} {figures} {slowest:8.2f}")
    bad = [one for one in results if one.ending not in ("accepted", "refused")]
    for fault in {one.fault[-200:]: one for one in bad}.values():
        print(f"\n{fault.seed}: {fault.ending}\n{fault.fault}")
    passed = sum(one.passed for one in results)
    print(f"\n{len(results)} mutations of seed {seed} in {seconds:.0f} s; {passed} past the first parser")
    print(f"{Counter(one.ending for one in results)}; at most {megabytes:.0f} MB")
    return bool(bad) or megabytes > MAX_MEGABYTES


if __name__ == "__main__":
    command(main, own_cache=True)
