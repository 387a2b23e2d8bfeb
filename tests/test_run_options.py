"""An option of runs is declared once: commands, Python, manifests, merging and resuming follow."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from textwrap import dedent

import pytest

import bodycheck
from bodycheck.runs.request import Execution, Request, options, stored_fields
from tests.helpers.changed_package import copy_with
from tests.helpers.scenario_texts import tumbling

PACKAGE = Path(bodycheck.__file__).parent

DECLARATION = """    colour: str | None = field(default=None, metadata=_option("The colour.", "--colour"))
"""
"""The option that is added to a copy of the package, in one place."""

SCRIPT = """
import contextlib, inspect, io, json, sys
from pathlib import Path

import bodycheck
from bodycheck.cli.commands import main
from bodycheck.runs.directory import _describe, partial_of, selected
from bodycheck.runs.manifest import Identity
from bodycheck.runs.request import Request

def call(*words):
    out, sys.argv = io.StringIO(), ["bodycheck", *words]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            main()
        except SystemExit as ended:
            return int(ended.code or 0), out.getvalue()
    return 0, out.getvalue()

def stored(folder):
    return json.loads(Path(folder, "manifest.json").read_text())["request"]["colour"]

measured = ("mine.toml", "--engine", "reference:m1", "--dt", "0.1", "--no-speed", "--quiet")
for part, colour in (("1/2", "red"), ("2/2", "red"), ("2/2", "blue")):
    found = call("run", *measured, "--colour", colour, "--shard", part, "--out", f"{part[0]}-{colour}")
    assert found[0] == 0, found
status, text = call("merge", "1-red", "2-blue", "--out", "refused")
assert status == 2 and "colour is blue" in text, text
status, text = call("merge", "1-red", "2-red", "--out", "whole")
assert status == 0, text
request = Request(["mine.toml"], engines=["reference:m1"], dt_s=[0.1], speed=False, colour="green")
_describe(partial_of(Path("resumed")), request, Identity.new(), selected(request), Path("resumed"))
status, text = call("run", "--resume", "resumed", "--quiet")
assert status == 0, text
run = bodycheck.run(["mine.toml"], engines=["reference:m1"], dt_s=[0.1], speed=False, colour="grey")
print(*map(stored, ("1-red", "whole", "resumed")), run.manifest["request"]["colour"])
print("colour" in inspect.signature(bodycheck.run).parameters)
print("colour: The colour." in bodycheck.run.__doc__)
print(*("--colour" in call(command, "--help")[1] for command in ("run", "nightly")))
"""


@pytest.mark.slow
def test_a_new_option_is_known_wherever_options_are(tmp_path: Path) -> None:
    """A line in request.py adds it to both commands, to Python, the manifest, merging and resuming."""
    copy_with(tmp_path, "bodycheck/runs/request.py", "    speed_passes: int", DECLARATION)
    (tmp_path / "mine.toml").write_text(tumbling())
    done = subprocess.run(
        [sys.executable, "-c", dedent(SCRIPT)], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.stdout.splitlines() == ["red red green grey", "True", "True", "True True"], done.stderr


def test_each_option_has_one_sentence_and_at_most_one_flag() -> None:
    """Flags are distinct, and each option says in a sentence what it does."""
    flags = [one.flag for _, one in options().values() if one.flag]
    assert len(flags) == len(set(flags))
    assert all(one.about.endswith(".") for _, one in options().values())
    signature = inspect.signature(bodycheck.run)
    assert set(signature.parameters) == set(options())


def test_each_option_is_read_where_runs_are_made() -> None:
    """An option that nothing but the checks of requests reads has no effect."""
    read: set[str] = set()
    for file in (PACKAGE / "runs").rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if file.name != "request.py" or (isinstance(node, ast.FunctionDef) and node.decorator_list):
                read |= {one.attr for one in ast.walk(node) if isinstance(one, ast.Attribute)}
    assert {one.name for one in fields(Request)} <= read


def test_a_request_as_plain_data_is_the_same_request() -> None:
    """Arrays, tuples, generators and paths become lists and text, and nothing is lost."""
    given = Request((Path("a.toml"), "b"), dt_s=(0.1 * k for k in (1, 2)), jobs=2, shard="1/2", speed=False)
    again = Request(**given.data)
    assert again.data == given.data
    assert again.scenarios == ["a.toml", "b"]
    assert again.dt_s == [0.1, 0.2]
    assert given.data.keys() == {one.name for one in stored_fields()}


def test_what_changes_a_result_is_no_matter_of_execution() -> None:
    """Merging compares all options but those of the execution."""
    assert {one.name for one in fields(Request)} - {one.name for one in fields(Execution)} == {
        *("scenarios", "engines", "dt_s", "tolerances", "speed", "shard", "commit"),
        *("speed_passes", "stable_steps", "laws"),
    }


@pytest.mark.nightly
def test_a_shard_in_python_is_that_of_the_command(tmp_path: Path) -> None:
    """Its cases are those of one part, and the manifest says which."""
    (tmp_path / "mine.toml").write_text(tumbling())
    parts = [
        bodycheck.run(
            [tmp_path / "mine.toml"],
            engines=["reference:m1", "reference:rk4"],
            dt_s=[0.1],
            speed=False,
            shard=f"{k}/2",
        )
        for k in (1, 2)
    ]
    assert sorted(row["method"] for part in parts for row in part.rows("results")) == ["m1", "rk4"]
    assert [part.manifest["shard"]["shard"] for part in parts] == ["1/2", "2/2"]
