"""A simulated history of thirty nightly runs with twelve events: status, first line and open list of each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree as ET

import pandas as pd
import pytest

from bodycheck.reports.history.acceptances import accept
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import read_summary
from bodycheck.reports.history.open_regressions import open_lines
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs.nightly_run import store_nightly
from tests.helpers.gate_tables import with_tables
from tests.helpers.nightly_runs import as_nightly_run, unchanged, without_pages

STATUS = {0: "no regression", 1: "regression", 3: "insufficient history"}
CAUSE = "the gyroscopic term omega x I omega is multiplied by 0.9"
ENGINES = {"m1": "alpha", "rk4": "alpha", "m2": "beta"}


@dataclass(frozen=True)
class Night:
    """What is planted in a nightly run, and what it must say: exit status, first line, open lines.

    factors: engine:method -> factor of its error at 0.01 s on `slow`. cause: of them. gone, failed: engines
    without cases, or whose cases fail. new: whether gamma runs. accepted: accept all before this run. killed:
    nothing is stored. cores: of the machine.
    """

    says: str
    status: int = 0
    open: tuple[str, ...] = ()
    factors: tuple[tuple[str, float], ...] = ()
    cause: str = ""
    gone: str = ""
    failed: str = ""
    new: bool = False
    accepted: str = ""
    killed: bool = False
    cores: int = 2


def worse(who: str, times: str) -> str:
    """Return the line of an error at dt 0.01 s."""
    return f"{who}: error at dt 0.01 s {times} in slow"


QUIET = "No regression."


def back(*methods: str) -> str:
    """Return the first line of a nightly run in which methods are at their level again."""
    return f"No regression; {', '.join(methods)} back at {'its' if len(methods) == 1 else 'their'} level."


BROKEN = (
    f"alpha:m1: no longer converges, error at dt 0.01 s x 50 in slow ({CAUSE}, explains all of the error)"
)
BOTH = f"alpha: m1 and rk4: error at dt 0.01 s x 50 in slow ({CAUSE}, explains all of the error)"
GONE = "beta:m2: no longer measured (8 cases) in slow and 1 more scenario"
CRASH = tuple(
    f"alpha:{name}: failed in 8 cases (ok before) in slow and 1 more scenario" for name in ("m1", "rk4")
)
X3 = worse("beta:m2", "x 3")
M1 = (("alpha:m1", 50.0),)
BETA3, BETA4 = (("beta:m2", 3.0),), (("beta:m2", 3.6),)
CREEP = {n: (*BETA3, ("gamma:m2", 1.007**n)) for n in (1, 2, 3, 4)}
GAMMA = (*BETA3, ("gamma:m2", 2.0))

NIGHTS = (
    Night("First nightly run: nothing to compare with yet, 24 cases stored for the next run.", 3),
    *(Night(QUIET),) * 3,
    Night(BROKEN, 1, (BROKEN,), M1, CAUSE),  # 1: broken on the fifth night
    Night(f"Still worse since 2026-01-05 (2 nightly runs): {BROKEN}", 1, (BROKEN,), M1, CAUSE),  # 2
    Night(back("alpha:m1")),  # 3: repaired
    Night(X3, 1, (X3,), BETA3),
    Night(f"Still worse since 2026-01-08 (2 nightly runs): {X3}", 1, (X3,), BETA3),
    Night(QUIET, factors=BETA3, accepted="the new step is meant"),  # 4: accepted
    Night(QUIET, factors=BETA3),
    Night(worse("beta:m2", "+20 %"), 1, (worse("beta:m2", "+20 %"),), BETA4),  # 5: accepted and worse again
    Night(back("beta:m2"), factors=BETA3),
    Night(GONE, 1, (GONE,), gone="beta"),  # 6: an engine vanished
    Night(back("beta:m2"), factors=BETA3),
    Night(QUIET, factors=BETA3, new=True),  # 7: a new engine
    Night(BOTH, 1, (BOTH,), (*BETA3, *M1, ("alpha:rk4", 50.0)), CAUSE, new=True),  # 8: one cause
    Night(back("alpha: m1 and rk4"), factors=BETA3, new=True),
    Night(QUIET, factors=CREEP[1], new=True),
    Night(QUIET, factors=CREEP[2], new=True),
    Night(worse("gamma:m2", "+2.1 %"), 1, (worse("gamma:m2", "+2.1 %"),), CREEP[3], new=True),  # 9: creeping
    Night(
        f"Still worse since 2026-01-21 (2 nightly runs): {worse('gamma:m2', '+2.8 %')}",
        *(1, (worse("gamma:m2", "+2.8 %"),), CREEP[4]),
        new=True,
    ),
    Night(QUIET, factors=CREEP[4], new=True, accepted="slower decay"),
    Night(f"{CRASH[0]}; 1 more regression", 1, CRASH, CREEP[4], failed="alpha", new=True),  # 10: a crash
    Night(back("alpha:m1", "alpha:rk4"), factors=CREEP[4], new=True),
    Night("", killed=True),  # 11: a nightly run that was killed
    Night(worse("gamma:m2", "+94 %"), 1, (worse("gamma:m2", "+94 %"),), GAMMA, new=True),
    Night(  # 12: another machine, with what is open on the one before
        f"Still worse since 2026-01-27 (2 nightly runs): {worse('gamma:m2', '+94 %')}",
        *(1, (worse("gamma:m2", "+94 %"),), GAMMA),
        new=True,
        cores=8,
    ),
    Night(back("gamma:m2"), factors=CREEP[4], new=True, cores=8),
    Night(QUIET, factors=CREEP[4], new=True, cores=8),
)


@pytest.fixture(scope="module")
def engines_run(nightly_run: Run) -> Run:
    """Return the run of the three methods as one of the engines alpha, beta, and gamma, a copy of beta."""

    def shared(table: pd.DataFrame) -> pd.DataFrame:
        made = table.assign(engine=table["method"].map(ENGINES))
        return pd.concat([made, made[made["engine"] == "beta"].assign(engine="gamma")], ignore_index=True)

    about = nightly_run.manifest["engines"]["reference"]
    methods = {"alpha": ("m1", "rk4"), "beta": ("m2",), "gamma": ("m2",)}
    engines = {
        name: {**about, "methods": {one: about["methods"][one] for one in own}}
        for name, own in methods.items()
    }
    run = with_tables(
        nightly_run,
        results=shared(nightly_run.results),
        methods=shared(nightly_run.methods),
        stability=shared(nightly_run.stability),
        probes=[],
        fingerprints=[],
        laws=[],
    )
    return replace(run, manifest={**nightly_run.manifest, "engines": engines})


def planted(run: Run, night: Night, number: int) -> Run:
    """Return the run as a nightly run with what is planted in it."""
    absent = {night.gone} | ({"gamma"} if not night.new else set())
    kept = {
        name: getattr(run, name)[~getattr(run, name)["engine"].isin(absent)]
        for name in ("results", "methods", "stability")
    }
    results, methods = kept["results"].copy(), kept["methods"].copy()
    diagnoses = []
    for who, factor in night.factors:
        engine, _, method = who.partition(":")
        mine = (results["engine"] == engine) & (results["method"] == method) & (results["scenario"] == "slow")
        results.loc[mine & (results["dt_s"] == 0.01), ORIENTATION] *= factor
        if night.cause and engine == "alpha":
            text = f"{night.cause} (explains all of the error)"
            row = {"scenario": "slow", "engine": engine, "method": method, "verdict": "explained"}
            row |= {"faults": "gyroscopic-term", "diagnosis": text, "reproduce": "bodycheck run slow"}
            diagnoses.append(row)
    if night.says.endswith(BROKEN):
        wrong = (methods["engine"] == "alpha") & (methods["method"] == "m1") & (methods["scenario"] == "slow")
        methods.loc[wrong & (methods["quantity"] == ORIENTATION), "verdict"] = "does-not-converge"
    failing = results["engine"] == night.failed
    always = ("run_id", "scenario", "family", "engine", "engine_version", "method", "control", "dt_s")
    emptied = [name for name in results.columns if name not in (*always, "reproduce", "reused")]
    results.loc[failing, emptied] = None
    results.loc[failing, "outcome"] = "failed"
    made = with_tables(
        run,
        results=results,
        methods=methods,
        stability=kept["stability"],
        diagnoses=diagnoses,
    )
    engines = {name: about for name, about in run.manifest["engines"].items() if name not in absent}
    return as_nightly_run(made, 24 * number + 3, unchanged, engines=engines, cores=night.cores)


def events(history: History) -> Iterator[list[str]]:
    """Yield run id and kind of what the feed lists: what was opened, closed and accepted in each run."""
    ended = [night for night in NIGHTS if not night.killed]
    for folder, before, night in zip(history.runs()[1:], ended, ended[1:], strict=False):
        still = night.says.startswith("Still")
        yield from [[folder.name, "closed"]] * len(() if still or night.accepted else before.open)
        yield from [[folder.name, "accepted"]] * bool(night.accepted)
        yield from [[folder.name, "opened"]] * len(() if still else night.open)


@pytest.mark.nightly
def test_every_night_of_a_month_says_what_is_open(engines_run: Run, tmp_path: Path) -> None:
    """Status, first line, open list and feed are the right ones, whatever happened before."""
    history, said = History.at(tmp_path), []
    for number, night in enumerate(NIGHTS):
        if night.accepted:
            accept(history, run_id=None, ids=[], reason=night.accepted, author="Ada")
        if night.killed:
            (tmp_path / ".unfinished-20260126T030000Z-000000").mkdir()
            said.append((0, "", ()))
            continue
        with without_pages():  # what is planted has no motions
            judged, folder = store_nightly(planted(engines_run, night, number), history)
        summary = read_summary(folder)
        assert summary["headline"] in (folder / "night.html").read_text().replace("&#39;", "'")
        status = next(code for code, name in STATUS.items() if name == judged.status)
        said.append((status, summary["headline"], tuple(one.text for one in open_lines(judged.open))))
    assert said == [(night.status, night.says, night.open) for night in NIGHTS]
    feed = ET.parse(tmp_path / "feed.xml").getroot().iterfind("{*}entry/{*}id")
    assert [str(one.text).split(":")[2:4] for one in feed][::-1] == list(events(history))
    assert len(NIGHTS) == 30
