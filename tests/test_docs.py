"""What README and docs show works word for word."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bodycheck
from bodycheck.reports.trajectory_files import trajectory_table
from bodycheck.scenarios.reader import parse_members

ROOT = Path(__file__).parents[1]


def blocks(page: str, language: str) -> list[str]:
    """Return the code blocks of one language on a page."""
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / page).read_text(), flags=re.DOTALL)


def commands() -> list[str]:
    """Return the bodycheck commands of README and docs, without their comments."""
    lines = "\n".join([*blocks("README.md", "sh"), *blocks("docs/scenarios.md", "sh")]).splitlines()
    return [line.partition("#")[0].strip() for line in lines if line.startswith("bodycheck ")]


@pytest.fixture
def folder(tmp_path: Path, stored_run: Path) -> Path:
    """Return a folder with the files and runs that the commands speak of."""
    for run in ("yesterday", "today"):
        shutil.copytree(stored_run, tmp_path / run)
    (tmp_path / "my-scenario.toml").write_text(blocks("docs/scenarios.md", "toml")[0])
    (tmp_path / "gates.toml").write_text(blocks("docs/gates.md", "toml")[0])
    loads, shapes = blocks("docs/scenarios.md", "python")
    (tmp_path / "my_loads.py").write_text(loads)
    (tmp_path / "my_shapes.py").write_text(shapes)
    truth = bodycheck.truth("intermediate-axis", [0.0, 1.0, 2.0]).trajectory
    trajectory_table(truth).to_csv(tmp_path / "my.csv", index=False)
    corners = ["0 0 0", "1 0 0", "0 1 0", "0 0 1"]
    facets = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
    loops = ["outer loop", *("vertex {}",) * 3, "endloop"]
    lines = ["solid part"]
    for facet in facets:
        vertices = iter(corners[i] for i in facet)
        lines += ["facet normal 0 0 0"]
        lines += [line.format(next(vertices)) if "{}" in line else line for line in loops]
        lines += ["endfacet"]
    (tmp_path / "part.stl").write_text("\n".join([*lines, "endsolid part", ""]))
    return tmp_path


def test_readme_and_docs_show_commands() -> None:
    """The list that the next test runs has those of either."""
    assert len(commands()) >= 9


@pytest.mark.slow
@pytest.mark.parametrize("line", commands())
def test_a_command_that_is_shown_works(line: str, folder: Path) -> None:
    """Each command of README and docs ends with status 0."""
    words = [sys.executable, "-m", *shlex.split(line)]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("code", blocks("README.md", "python"))
def test_python_of_the_readme_works(code: str) -> None:
    """Each Python block of the README runs."""
    exec(compile(code, "README.md", "exec"), {})


def test_the_small_body_shows_what_the_readme_says() -> None:
    """PyBullet in maximal coordinates does not converge on the small body; in reduced ones it does."""
    pytest.importorskip("pybullet")
    found = bodycheck.run([ROOT / "docs/small-body.toml"], engines=["pybullet"], speed=False).methods
    verdicts = found[found["quantity"] == "orientation_error_rad"].set_index("method")["verdict"]
    assert verdicts.to_dict() == {"multibody": "converges", "maximal": "does-not-converge"}


BODY = re.compile(r"^\[body\]\n.*?\n\n", flags=re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("text", blocks("docs/scenarios.md", "toml"))
def test_scenarios_of_the_docs_are_accepted(text: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each scenario shown is a good one, and so is the first with each of the other tables in or after it."""
    monkeypatch.chdir(folder)
    first = blocks("docs/scenarios.md", "toml")[0]
    if 'kind = "pivot"' in text:  # about which the centre of mass cannot start at rest while the body turns
        first = re.sub(r"^velocity_m_s.*\n", "", first, flags=re.MULTILINE)
    whole = (
        text if text == first else BODY.sub(text + "\n", first) if text.startswith("[body]") else first + text
    )
    assert text in whole
    members = parse_members(whole, "docs/scenarios.md", folder, allow_code=True)
    assert all(scenario.scene.loads for scenario in members.values())


def test_ci_runs_the_test_command_of_the_readme() -> None:
    """The README has exactly one line that ends in -m pytest, which is the one that CI takes."""
    lines = (ROOT / "README.md").read_text().splitlines()
    assert sum(line.endswith("-m pytest") for line in lines) == 1
