"""The commands that analyse stored runs, as a user runs them."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import duckdb
import pandas as pd
import pytest

from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.scenario_texts import tumbling

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def command(stored_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    """Return a function that runs a command in this process; `run` is a stored run and `other` its copy."""
    monkeypatch.chdir(tmp_path)
    for name in ("run", "other"):
        shutil.copytree(stored_run, name)

    def requested(*words: str) -> tuple[int, str, str]:
        done = run_bodycheck(tmp_path, *words)
        return done.returncode, done.stdout, done.stderr

    return requested


def test_two_equal_runs_did_not_change(command: Command) -> None:
    """The text, Markdown and page state it in one sentence, and the status is 0 even with --fail-on moved."""
    files = {"--html": "changes.html", "--markdown": "changes.md"}
    words = [word for pair in files.items() for word in pair]
    status, out, _ = command("compare", "run", "other", "--fail-on", "moved", *words)
    assert status == 0
    for text in (out, *(Path(file).read_text() for file in files.values())):
        assert "Nothing changed beyond round-off" in text


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("factor", "words", "statuses"),
    [
        (1.01, (), {"never": 0, "worse": 0, "moved": 1}),
        (1.05, (), {"never": 0, "worse": 1, "moved": 1}),
        (1.05, ("--threshold", "0.1"), {"never": 0, "worse": 0, "moved": 1}),
        (1.05, ("--thresholds", "thresholds.toml"), {"never": 0, "worse": 0, "moved": 1}),
        (0.5, (), {"never": 0, "worse": 0, "moved": 0}),
    ],
)
def test_the_status_is_1_where_what_fails_is_found(
    command: Command, factor: float, words: tuple[str, ...], statuses: dict[str, int]
) -> None:
    """--fail-on is worse, moved or never; the threshold is an option or set per measure in a file."""
    Path("thresholds.toml").write_text(
        '[[change]]\nmeasure = "energy_drift"\nthreshold = 0.2\nreason = "a test"\n'
    )
    table = pd.read_csv("other/results.csv", dtype=str, keep_default_na=False)
    mine = (table["scenario"] == "free") & (table["method"] == "m1") & (table["dt_s"] == "0.01")
    for name in ("energy_drift", "energy_drift_abs", "energy_drift_signed"):
        table.loc[mine, name] = [repr(factor * float(cell)) for cell in table.loc[mine, name]]
    table.to_csv("other/results.csv", index=False)
    assert mine.any()
    for when, wanted in statuses.items():
        status, out, error = command("compare", "run", "other", "--fail-on", when, *words)
        assert (status, error) == (wanted, "")
        assert "reference" in out.splitlines()[0]
    assert command("compare", "run", "other", *words)[0] == 0


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (("--threshold", "-0.1"), "--threshold -0.1: must be 0 or more, like 0.02 for 2 %"),
        (("--threshold", "nan"), "--threshold nan: must be 0 or more, like 0.02 for 2 %"),
        (("--thresholds", "absent.toml"), "absent.toml: cannot be read"),
        (("--thresholds", "wrong.toml"), "wrong.toml: change[0].measure: verdict has no threshold"),
        (("--html", "made.html", "--markdown", "absent/told.md"), "--markdown absent/told.md"),
    ],
)
def test_a_wrong_comparison_is_refused(command: Command, words: tuple[str, ...], reported: str) -> None:
    """The status is 2 with an error of one line, and no file is written."""
    Path("wrong.toml").write_text('[[change]]\nmeasure = "verdict"\nthreshold = 0.2\nreason = "r"\n')
    status, out, error = command("compare", "run", "other", *words)
    assert (status, out) == (2, "")
    assert reported in error
    assert len(error.splitlines()) == 1
    assert not list(Path().glob("made*"))


def test_runs_that_have_nothing_in_common_do_not_pass(command: Command) -> None:
    """With --fail-on the status is 1, because a comparison of nothing proves nothing."""
    manifest = json.loads(Path("other/manifest.json").read_text())
    for scenario in manifest["scenarios"].values():
        scenario["duration_s"] *= 2.0
    Path("other/manifest.json").write_text(json.dumps(manifest))
    for when, wanted in (("never", 0), ("worse", 1), ("moved", 1)):
        status, out, _ = command("compare", "run", "other", "--fail-on", when)
        assert status == wanted
        assert "Nothing could be compared." in out


def test_what_changed_is_named_and_the_status_stays_0(command: Command) -> None:
    """The output names each change, and the status is 0 unless --fail-on is given."""
    table = Path("other/results.csv")
    table.write_text(re.sub(r"(,m1,dt,float64,0\.01,.*),ok,", r"\1,failed,", table.read_text()))
    manifest = json.loads(Path("other/manifest.json").read_text())
    moved = table.read_text().count(",failed,") - manifest["outcomes"]["failed"]
    manifest["outcomes"]["ok"] -= moved
    manifest["outcomes"]["failed"] += moved
    Path("other/manifest.json").write_text(json.dumps(manifest))
    assert moved > 1
    status, out, _ = command("compare", "run", "other")
    assert status == 0
    assert re.search(r"^free +reference:m1 +outcome ok -> failed at dt 0.01 s$", out, flags=re.MULTILINE)


def test_a_report_is_written_anew(command: Command) -> None:
    """`report` writes the page of the run again, with identical content."""
    page = Path("run/report.html")
    before = page.read_bytes()
    page.write_text("lost")
    assert command("report", "run")[:2] == (0, "run/report.html\n")
    assert page.read_bytes() == before
    assert sorted(path.name for path in Path("run").iterdir()) == sorted(
        path.name for path in Path("other").iterdir()
    )


def test_the_markdown_says_what_failed_and_how_to_see_it_again(command: Command) -> None:
    """The Markdown has under 60 lines: outcomes, the failure with its command, versions and machine."""
    status, printed, _ = command("report", "run", "--markdown", "summary.md")
    assert printed == "summary.md\n"
    out = Path("summary.md").read_text()
    manifest = json.loads(Path("run/manifest.json").read_text())
    lines = out.splitlines()
    assert status == 0
    assert len(lines) < 60
    assert any(line.startswith("| failing:m1 | failed in 1 case") for line in lines)
    assert "--engine failing:m1 --dt 0.02" in out
    assert f"{manifest['outcomes']['ok']} ok" in out
    assert f"bodycheck {manifest['bodycheck']}; reference" in lines[-1]
    assert manifest["run_id"] in lines[-1]


def test_advice_is_that_of_the_run_that_is_named(command: Command) -> None:
    """Advice covers all scenarios of the run or those requested; a scenario that the run lacks is refused."""
    status, out, _ = command("advise", "--error", "1e-2", "--run", "run", "free")
    assert status == 0
    assert re.search(r"^reference:\S+ +(dt|tolerance|no steps)", out, flags=re.MULTILINE)
    assert "forced" not in out
    status, out, err = command("advise", "--error", "1e-2", "--run", "run", "intermediate-axis")
    assert (status, out) == (2, "")
    assert err.startswith("run: has no scenario intermediate-axis (available: free, ")


@pytest.mark.slow
def test_advice_predicts_and_a_search_measures(command: Command) -> None:
    """The command of a prediction confirms it; after a search every answer is measured."""
    Path("mine.toml").write_text(tumbling(steps_s=[0.05, 0.02, 0.01, 0.005]))
    words = ("--engine", "reference:rk4,reference:m1", "--no-speed", "--out", "rk4")
    assert command("run", "mine.toml", *words)[0] == 0
    requested = ("advise", "--error", "3e-5", "--run", "rk4")
    status, out, _ = command(*requested)
    assert status == 0
    predicted = re.search(r"^reference:rk4 +dt (\S+) s +(\S+) +predicted ", out, flags=re.MULTILINE)
    assert predicted is not None, out
    dt_s, most = predicted.groups()
    assert f"confirm with: bodycheck run mine.toml --engine reference:rk4 --dt {dt_s}\n" in out
    confirming = re.search(r"^confirm with: bodycheck (.*)", out, flags=re.MULTILINE)
    assert confirming is not None
    assert command(*confirming[1].split(), "--no-speed")[0] == 0
    first, second, *_ = command(*requested)[1].splitlines()
    assert re.fullmatch(rf"confirmed: \S+ <= 3e-5 rad; use reference:rk4 with dt = {dt_s} s", first)
    assert re.search(r", from the run rk4, confirmed by bodycheck-runs/\S+$", second)
    Path("mine.toml").unlink()  # the run stores its scenarios
    status, out, err = command(*requested, "--search")
    assert status == 0, err
    measured = re.search(r"^reference:rk4 +dt (\S+) s +(\S+) +measured", out, flags=re.MULTILINE)
    assert measured is not None, out
    assert measured[1] == dt_s
    assert float(measured[2]) <= float(most)


@pytest.mark.slow
def test_a_search_needs_the_engines_of_the_run(command: Command) -> None:
    """An engine that is no longer available is named."""
    status, out, err = command("advise", "--error", "3e-4", "--run", "run", "free", "--search")
    assert (status, out) == (2, "")
    assert "unknown engine 'failing' (available: " in err


def test_advice_gives_the_error_of_a_step(command: Command) -> None:
    """Each method has a measured or predicted error; a method without steps is named."""
    status, out, _ = command("advise", "--dt", "4e-3", "--run", "run", "free")
    assert status == 0
    lines = out.splitlines()
    assert lines[0].startswith("most accurate engine with dt = 0.004 s: failing:m1, error at most ")
    assert lines[1] == "orientation_error_rad at dt 0.004 s in free, 1 s, from the run run"
    shown = {line.split()[0]: line.split() for line in lines if line.startswith("reference:")}
    assert shown["reference:rk4"][5] in ("measured", "predicted")
    assert float(shown["reference:rk4"][4]) < 1e-6 < float(shown["reference:m1"][4])
    assert any(re.fullmatch(".*reference:exact.*: has no step", line) for line in lines)


@pytest.mark.slow
def test_a_horizon_limits_the_time_over_which_errors_count(command: Command) -> None:
    """The error of a method of order 1 grows with time; a scenario that ends earlier is named."""

    def error(*words: str) -> tuple[float, str]:
        status, out, err = command("advise", "--dt", "1e-2", "--run", "run", "free", *words)
        assert status == 0, err
        (line,) = [line for line in out.splitlines() if line.startswith("reference:m1 ")]
        return float(line.split()[4]), err

    whole, note = error("--horizon-s", "100")
    assert (whole, "") == error()
    assert note == "note: shorter than --horizon-s 100.0, counted whole: free (1 s)\n"
    part, note = error("--horizon-s", "0.3")
    assert part < 0.7 * whole
    assert note == ""
    status, _, err = command("advise", "--dt", "1e-2", "--run", "run", "free", "--horizon-s", "1e-3")
    assert (status, err[:26]) == (2, "--horizon-s 0.001: the fir")


def test_run_that_confirms_an_answer_does_not_replace_the_fuller_run(command: Command) -> None:
    """An older run is preferred to the newest one if it has all methods of the newest and more."""
    for name, created in (("full", "2026-01-01T00:00:00+00:00"), ("part", "2026-02-01T00:00:00+00:00")):
        shutil.copytree("run", Path("bodycheck-runs", name))
        path = Path("bodycheck-runs", name, "manifest.json")
        manifest = json.loads(path.read_text())
        manifest["created"] = created
        methods = manifest["engines"]["reference"]["methods"]
        if name == "full":
            methods["another"] = methods["m1"]
        path.write_text(json.dumps(manifest))
    assert "from the run bodycheck-runs/full" in command("advise", "--error", "1e-2")[1]


def test_advice_is_that_of_the_newest_run_with_these_very_scenarios(command: Command) -> None:
    """An older run is used if the newest one lacks a scenario or has a different one of the same name."""
    runs = Path("bodycheck-runs")
    for name, created in (("old", "2026-01-01T00:00:00+00:00"), ("new", "2026-02-01T00:00:00+00:00")):
        shutil.copytree("run", runs / name)
        manifest = json.loads((runs / name / "manifest.json").read_text())
        manifest["created"] = created
        (runs / name / "manifest.json").write_text(json.dumps(manifest))
    assert "from the run bodycheck-runs/new" in command("advise", "--error", "1e-2")[1]
    shape = Path("shape.toml")
    shape.write_text(
        'name = "shape"\nduration_s = 1.0\nsamples = 11\nsteps_s = [0.02, 0.01]\n'
        '[body]\nshape = "torus"\nsize_m = [0.7, 0.21]\ndensity_kg_m3 = 333.3\n'
        "[initial]\nomega_world_rad_s = [0.3, 1.0, -0.2]\n"
        '[[sweep]]\nkey = "source"\nvalues = ["1"]\n'
    )
    assert "from the run bodycheck-runs/new" in command("advise", "--error", "1e-2", "shape.toml")[1]
    manifest = json.loads((runs / "new/manifest.json").read_text())
    manifest["scenarios"]["shape/1"]["duration_s"] = 2.0
    (runs / "new/manifest.json").write_text(json.dumps(manifest))
    assert "from the run bodycheck-runs/old" in command("advise", "--error", "1e-2", "shape.toml")[1]
    (runs / "odd").mkdir()
    (runs / "odd/manifest.json").write_text("{}")
    (runs / "new/results.csv").write_text("")
    status, out, err = command("advise", "--error", "1e-2")
    assert (status, "from the run bodycheck-runs/old" in out) == (0, True)
    left_out = [line for line in err.splitlines() if line.startswith("warning: a damaged run is ignored: ")]
    assert [line.split(": ")[2] for line in left_out] == [
        "bodycheck-runs/odd/manifest.json",
        "bodycheck-runs/new/results.csv",
    ]


def test_a_user_function_needs_permission_in_every_command(command: Command) -> None:
    """The message recommends --allow-code only for commands that have this option."""
    forcing = '[[forcing]]\nkind = "callable"\nfunction = "math:hypot"\n'
    Path("called.toml").write_text(tumbling("called") + forcing)
    for words in (
        ["advise", "--error", "1", "--run", "run", "called.toml"],
        ["versions", "reference", "--since", "1.0", "--scenario", "called.toml"],
    ):
        status, _, err = command(*words)
        assert status == 2
        assert "add --allow-code if you trust called.toml:12" in err
        status, _, err = command(*words, "--allow-code")
        assert status == 2
        assert re.match(r"run: has no scenario called \(available: |reference==1\.0: ", err)


def test_a_table_is_printed_or_written(command: Command) -> None:
    """`table` prints only the requested columns in the requested order, or writes the whole file."""
    assert command("table", "run", "methods", "--columns", "verdict, method")[1].startswith(
        "verdict,method\n"
    )
    words = ("table", "run", "--columns", "scenario")
    assert command(*words, "--format", "md")[1].startswith("| scenario |\n| --- |\n| free |\n")
    assert json.loads(command(*words, "--format", "json")[1])[0] == {"scenario": "free"}
    assert command(*words, "--parquet", "t.parquet")[:2] == (0, "t.parquet\n")
    assert duckdb.sql("SELECT scenario FROM 't.parquet' LIMIT 1").fetchall() == [("free",)]


def test_a_figure_is_drawn(command: Command) -> None:
    """`plot` writes and prints the named files."""
    pytest.importorskip("matplotlib")
    files = ("--svg", "a.svg", "--png", "a.png")
    done = command("plot", "run", "--figure", "order", "--scenario", "free", *files)
    assert done[:2] == (0, "a.svg\na.png\n")
    assert Path("a.svg").read_text().startswith("<?xml")
    assert Path("a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow(after=1)
@pytest.mark.parametrize("suffix", ["gif", "svg"])
def test_a_movie_is_written(suffix: str, command: Command) -> None:
    """`movie` says first which body is farthest from the truth, and when; its last line is the file."""
    pytest.importorskip("matplotlib")
    out = f"film.{suffix}"
    words = ("movie", "run", "--scenario", "free", "--engine", "reference", f"--{suffix}", out)
    status, shown, _ = command(*words)
    assert status == 0
    first, *_, last = shown.splitlines()
    assert re.match(
        r"free, dt \S+ s: farthest from the truth is reference:\S+, by \S+ rad at \S+ s\.$", first
    )
    assert last == out
    assert Path(out).read_bytes().startswith({"gif": b"GIF89a", "svg": b"<?xml"}[suffix])


def body(inertia: str = "2e-3,3e-3,4e-3", spin: str = "20") -> list[str]:
    """Return the options of a body on the command line."""
    return ["--mass-kg", "0.5", "--inertia-kg-m2", inertia, "--spin-rad-s", spin]


WRONG = {
    "no run": (["compare", "run", "nowhere"], "nowhere/manifest.json: missing: not a run folder"),
    "a page nowhere": (["compare", "run", "other", "--html", "no/a.html"], "no/a.html: cannot be written"),
    "no run to report": (["report", "."], "manifest.json: missing: not a run folder"),
    "no error": (["advise", "--run", "run"], "give either --error, the tolerance to meet, or --dt"),
    "an error and a step": (
        ["advise", "--error", "1", "--dt", "1"],
        "give either --error, the tolerance to meet, or --dt",
    ),
    "half a body": (
        ["advise", "--error", "1", "--mass-kg", "1"],
        "a body needs --mass-kg, --inertia-kg-m2 and",
    ),
    "a body and a run": (
        ["advise", "--error", "1", "--run", "run", *body()],
        "a body on the command line replaces scenarios and --run",
    ),
    "two moments": (
        ["advise", "--error", "1", *body(inertia="1,2")],
        "must be three principal moments",
    ),
    "an impossible body": (
        ["advise", "--error", "1", *body(inertia="1,2,9")],
        "body.inertia_kg_m2",
    ),
    "a body at rest": (
        ["advise", "--error", "1", *body(spin="0")],
        "--spin-rad-s: |omega| must be from",
    ),
    "two errors": (["advise", "--error", "1", "--error", "2"], "--error: given 2 times"),
    "a row as JSON": (["ensemble", "free-flight", "--row", "5", "--json"], "--json does not apply"),
    "a row of a shard": (
        ["ensemble", "free-flight", "--row", "5", "--shard", "1/2"],
        "--shard does not apply",
    ),
    "a horizon in the past": (
        ["advise", "--error", "1", "--run", "run", "--horizon-s=-1"],
        "--horizon-s -1.0: must be a positive number",
    ),
    "a search for a step": (["advise", "--dt", "1", "--search"], "--search: searches the settings"),
    "an error in words": (["advise", "--error", "small"], "Invalid value for '--error'"),
    "an error below 0": (["advise", "--error=-1"], "--error -1.0: must be a positive number"),
    "an unknown quantity": (
        ["advise", "--error", "1", "--measure", "beauty"],
        "--measure beauty: unknown measure (available: orientation_error_rad",
    ),
    "an unknown column": (
        ["table", "run", "--columns", "beauty"],
        "results has no beauty (available: run_id",
    ),
    "a column twice": (["table", "run", "--columns", "dt_s,dt_s"], "has a column twice"),
    "an unknown table": (["table", "run", "beauty"], "beauty: no table of a run (available: results"),
    "no scenario": (
        ["plot", "run", "--figure", "order", "--svg", "a.svg"],
        "--scenario is required (available: free",
    ),
    "another scenario": (
        ["plot", "run", "--figure", "order", "--svg", "a.svg", "--scenario", "x"],
        "--scenario x: not in this run (available: free",
    ),
    "a figure without a format": (
        ["plot", "run", "--figure", "order", "--scenario", "free"],
        "plot: name a file with --svg or --pdf or --png",
    ),
    "a figure nowhere": (
        ["plot", "run", "--figure", "order", "--svg", "no/a.svg", "--scenario", "free"],
        "--svg no/a.svg: cannot be written: there is no folder",
    ),
    "a figure of nothing": (
        [*("plot", "run", "--figure", "order", "--svg", "a.svg", "--scenario", "free"), "--measure", "x"],
        "--measure x: unknown measure (available: energy_drift",
    ),
    "a film without a format": (
        ["movie", "run", "--scenario", "free"],
        "movie: name a file with --gif or --mp4 or --svg",
    ),
    "a film of an unmeasured step": (
        ["movie", "run", "--scenario", "free", "--gif", "a.gif", "--dt", "0.3"],
        "--dt 0.3: no motion has this step (available: ",
    ),
    "a film of an unknown engine": (
        ["movie", "run", "--scenario", "free", "--gif", "a.gif", "--engine", "nobody"],
        "--engine nobody: not in this run (available: ",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_question_ends_with_status_2_and_one_clear_line(what: str, command: Command) -> None:
    """The message names the error and its place; standard output is empty and no file is written."""
    before = sorted(Path().rglob("*"))
    words, message = WRONG[what]
    status, out, err = command(*words)
    assert status == 2
    assert out == ""
    assert message in err
    assert sorted(Path().rglob("*")) == before
