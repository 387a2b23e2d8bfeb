"""The releases of engines: one-step map, order and error of each method. Each is measured once."""

from __future__ import annotations

import csv
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import scientific
from bodycheck.adapters.versions.uv import releases
from census.finding import HERE, INPUTS

MEASURED = HERE / "releases.csv"
HEADER = ("engine", "release", "method", "map", "order", "error at 1e-3 s, rad", "verdict")
_STEPS = "2e-2,1e-2,5e-3,2e-3,1e-3"
_TIMEOUT_S = "900"  # the first case of a release compiles its kernels
_FAILED = "does not run"
_CHANGING = ("map", "order", "verdict")
"""Columns whose change is a change; the error follows from map and order."""

Row = dict[str, str]


def read_releases(path: Path = MEASURED) -> list[Row]:
    """Return the rows of releases.csv, oldest release of each engine first."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def add_new_releases(engines: list[str], since: str | None) -> list[str]:
    """Measure the releases of engines that have no rows, and add them; return the changes, as sentences.

    since: the first release; without it, the last one with rows. If that one did not run it is tried again:
    what it requires may be had by now.
    """
    rows = read_releases() if MEASURED.exists() else []
    added = []
    for engine in engines or dict.fromkeys(row["engine"] for row in rows):
        own = [row for row in rows if row["engine"] == engine]
        if not (first := since or (own[-1]["release"] if own else None)):
            raise InputError(f"{engine} has no rows in {MEASURED.name}: name its first release by --since")
        own = [row for row in own if row is not own[-1] or not row["verdict"].startswith(_FAILED)]
        listed = releases(engine, first, None)
        for release in listed:
            if any(row["release"] == release for row in own):
                continue
            own += (found := list(measure(engine, release)))
            own.sort(key=lambda row: listed.index(row["release"]) if row["release"] in listed else -1)
            added.append((engine, release))
            print(f"{engine} {release}: {len(found)} methods", flush=True)
            rows = [*(row for row in rows if row["engine"] != engine), *own]
            _write(rows)
    return [one for engine, release, one in changes(rows) if (engine, release) in added]


def measure(engine: str, release: str) -> Iterator[Row]:
    """Yield a row per method of one release, of a free symmetric top; one without a method if none ran."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["run", str(INPUTS / "top.toml"), "--engine", f"{engine}=={release}", "--dt", _STEPS]
        # one at a time: two workers would compile the same kernels
        options = ["--no-speed", "--quiet", "--jobs", "1", "--timeout-s", _TIMEOUT_S, "--out", "run"]
        words = [sys.executable, "-m", "bodycheck", *command, *options]
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
        path = Path(folder) / "run" / "methods.csv"
        table = list(csv.DictReader(path.read_text(encoding="utf-8").splitlines())) if path.exists() else []
        why = "" if table else _why(path, done).replace(f"{engine}=={release}: ", "")
    table = [row for row in table if row["quantity"] == "orientation_error_rad"]
    for row in table:
        order = row["order"] and f"{float(row['order']):.1f}"
        error = row["finest_error"] and scientific(float(row["finest_error"]))
        values = (engine, release, row["method"], row["fingerprint"], order, error, row["verdict"])
        yield dict(zip(HEADER, values, strict=True))
    if not table:
        yield dict.fromkeys(HEADER, "") | {"engine": engine, "release": release, "verdict": why}


def _why(path: Path, done: subprocess.CompletedProcess[str]) -> str:
    """Return why no method ran: the message of a case, or the line that names the engine."""
    results = path.with_name("results.csv")
    rows = csv.DictReader(results.read_text(encoding="utf-8").splitlines()) if results.exists() else ()
    messages = [row["message"] for row in rows if row["message"]]
    messages += [one for one in (done.stdout + done.stderr).splitlines() if "cannot" in one]
    return f"{_FAILED}: {_without_paths(messages[0])[:120]}" if messages else _FAILED


def _without_paths(message: str) -> str:
    """Return the first line of the reason in a message, without paths of this machine."""
    return re.sub(r"( at)? /\S+", "", message.partition("; its last output")[0].partition("\\n")[0])


def changes(rows: list[Row]) -> Iterator[tuple[str, str, str]]:
    """Yield engine, release and a sentence for each method that differs from the release before."""
    last: dict[tuple[str, str], Row] = {}
    for row in rows:
        key = (row["engine"], row["method"])
        before = last.get(key)
        differs = _differences(before, row) if before else []
        if before and differs and row["method"]:
            what = ", ".join(f"{name} {before[name] or 'none'} -> {row[name] or 'none'}" for name in differs)
            yield (
                row["engine"],
                row["release"],
                f"{row['engine']} {row['release']}, `{row['method']}`: {what}",
            )
        last[key] = row


def _differences(before: Row, after: Row) -> list[str]:
    """Return the columns that changed; a map that is one of many candidates is not known well enough to."""
    many = any(re.search(r" or \d+ others\b", row["map"]) for row in (before, after))
    return [name for name in _CHANGING if before[name] != after[name] and not (many and name == "map")]


def spans(rows: list[Row]) -> list[Row]:
    """Return a row for each stretch of measured releases between which a method did not change.

    `release` is the first or `first to last`; the other columns are those of the last.
    """
    of_engine: dict[str, list[str]] = {}
    joined: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        releases_of = of_engine.setdefault(row["engine"], [])
        if row["release"] not in releases_of:
            releases_of.append(row["release"])
    for row in rows:
        stretches = joined.setdefault((row["engine"], row["method"]), [])
        measured = of_engine[row["engine"]]
        last = stretches[-1] if stretches else None
        is_next = last is not None and measured.index(row["release"]) == measured.index(last["last"]) + 1
        if last is None or not is_next or _differences(last, row):
            stretches.append(row | {"first": row["release"], "last": row["release"]})
        else:
            last |= row | {"release": f"{last['first']} to {row['release']}", "last": row["release"]}
    return [
        {name: one[name] for name in HEADER}
        for (engine, _), stretches in sorted(joined.items())
        for one in stretches
    ]


def _write(rows: list[Row]) -> None:
    with MEASURED.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, HEADER, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
