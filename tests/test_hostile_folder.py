"""Nothing is configured by the working directory: commands open none of its settings and modules."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from bodycheck.cli.commands import app
from tests.conftest import TETRAHEDRON
from tests.helpers.scenario_texts import tumbling

MODULES = (
    *(
        "numpy",
        "json",
        "numba",
        "scipy",
        "pandas",
        "duckdb",
        "matplotlib",
        "pydantic",
        "typer",
        "rich",
        "yaml",
    ),
    *(
        "jinja2",
        "trimesh",
        "mujoco",
        "pybullet",
        "dartpy",
        "uv",
        "pip",
        "distributed",
        "typing",
        "subprocess",
    ),
    *("sitecustomize", "usercustomize", "conftest", "llvmlite", "contextlib", "dataclasses"),
)
PROGRAM = "#!/bin/sh\ntouch RAN\n"
SETTINGS = {
    ".numba_config.yaml": "disable_jit: 1\nopt: 0\n",
    "matplotlibrc": "animation.ffmpeg_path: ./program\ntext.usetex: True\nfont.size: 40\n",
    "uv.toml": 'index-url = "file:///hostile"\n',
    "pyproject.toml": '[tool.uv]\nindex-url = "file:///hostile"\n[project]\nname = "x"\nversion = "1"\n',
    ".python-version": "2.7\n",
    "pip.conf": "[global]\nindex-url = file:///hostile\n",
    ".npmrc": "ignore-scripts=false\nregistry=http://hostile\n",
    "package.json": '{"type": "module", "scripts": {"preinstall": "./program"}}',
    ".duckdbrc": ".shell ./program\n",
    ".env": "PYTHONPATH=.\n",
    "engines.toml": "[engines.short]\ncommand = ['./program']\n",
    "setup.cfg": "[global]\nverbose=1\n",
    "dask.yaml": "distributed: {}\n",
    "pyvenv.cfg": "home = .\n",
    "program": PROGRAM,
    "ffmpeg": PROGRAM,
    "node": PROGRAM,
    "git": PROGRAM,
}

HOOK = """
import os, sys

_folder, _log = os.environ["HOSTILE_FOLDER"], os.environ["HOSTILE_LOG"]
_writing = False


def _hook(event, arguments):
    global _writing
    if _writing or event not in ("open", "import"):
        return
    path = arguments[0] if event == "open" else arguments[1]
    if isinstance(path, bytes):
        path = os.fsdecode(path)
    if not isinstance(path, str):
        return
    path = os.path.abspath(path)
    if path.startswith(_folder + os.sep):
        _writing = True
        with open(_log, "a") as log:
            log.write(os.path.relpath(path, _folder) + "\\t" + " ".join(sys.argv)[-300:] + "\\n")
        _writing = False


sys.addaudithook(_hook)
"""

RUN = ["--engine", "reference:rk4", "--dt", "0.05,0.025"]
COMMANDS: dict[str, list[str]] = {
    "run": ["run", "mine.toml", *RUN, "--out", "made/run"],
    "truth": ["truth", "mine.toml", "--at", "0,1"],
    "judge": ["judge", "made/truth.csv", "--scenario", "mine.toml"],
    "body": ["body", "part.obj", "--density-kg-m3", "1000"],
    "list": ["list", "methods"],
    "audit": ["audit", "part.urdf"],
    "dynamics": ["dynamics", "mujoco", "cart-pole"],
    "gradients": ["gradients", "reference:euler"],
    "compare": ["compare", "made/run", "made/run", "--html", "made/compare.html"],
    "advise": ["advise", "--run", "made/run", "--error", "1e-9", "--search"],
    "report": ["report", "made/run", "--markdown", "made/report.md"],
    "table": ["table", "made/run", "--parquet", "made/table.parquet"],
    "plot": ["plot", "made/run", "--figure", "drift", "--svg", "made/plot.svg"],
    "movie": ["movie", "made/run", "--gif", "made/movie.gif"],
    "explain": ["explain", "made/run"],
    "doctor": ["doctor"],
    "gate": ["gate", "mine.toml", "--gates", "gates.toml"],
    "nightly": ["nightly", "mine.toml", "--history", "made/nights", *RUN[:2]],
    "history list": ["history", "list", "made/nights"],
    "history query": ["history", "query", "made/nights", "SELECT run_id FROM nights"],
    "history accept": ["history", "accept", "made/nights", "--change", "x", "--reason", "x"],
    "history withdraw": ["history", "withdraw", "made/nights", "--change", "x", "--reason", "x"],
    "history prune": ["history", "prune", "made/nights", "--keep", "1"],
    "merge": ["merge", "made/run", "made/run", "--out", "made/merged"],
    "versions": ["versions", "mujoco", "--since", "3.6.0", "--scenario", "mine.toml"],
    "check-adapter": ["check-adapter", "reference:euler"],
    "new-adapter": ["new-adapter", "own-engine"],
    "fingerprint": ["fingerprint", "reference:euler"],
    "laws": ["laws", "reference:euler"],
    "ensemble": ["ensemble", "mine.toml", "--n", "20", "--engine", "reference:rk4", "--out", "made/ensemble"],
    "hunt": ["hunt", "mine.toml", "--engine", "reference:rk4", "--evaluations", "400", "--out", "made/hunt"],
    "init": ["init", "made", "--engine", "reference"],
    "schema": ["schema", "scenario"],
    "environments make": ["environments", "make", "mujoco==3.6.0"],
    "environments list": ["environments", "list"],
    "environments remove": ["environments", "remove", "mujoco==3.6.0"],
}
"""Every command, in an order in which each finds what it reads."""

INPUTS = {"mine.toml", "part.obj", "part.urdf", "gates.toml"}
READ_FILES = {"run", "truth", "judge", "body", "audit", "gate"}
"""The commands that are tried at each push: those that read the files of others."""
NEEDS_NETWORK = {"versions", "environments make", "environments remove"}


def _names(group: object, prefix: str = "") -> Iterator[str]:
    """Yield the names of all commands of a click group."""
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        if hasattr(command, "commands"):
            yield from _names(command, f"{prefix}{name} ")
        else:
            yield prefix + name


def test_every_command_is_tried() -> None:
    """A new command fails this test until COMMANDS has it."""
    assert set(COMMANDS) == set(_names(typer.main.get_command(app)))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder of inputs, full of hostile settings, modules and programs."""
    place = tmp_path / "hostile"
    place.mkdir()
    for name in MODULES:
        (place / f"{name}.py").write_text("import os\nos.close(os.open('RAN', os.O_CREAT))\n")
    for name, text in SETTINGS.items():
        (place / name).write_text(text)
        if text == PROGRAM:
            (place / name).chmod(0o755)
    (place / ".git").mkdir()
    (place / ".git/config").write_text("[core]\n\tfsmonitor = ./program\n\trepositoryformatversion = 0\n")
    (place / "mine.toml").write_text(tumbling())
    (place / "part.obj").write_text(TETRAHEDRON)
    inertial = '<mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    link = f'<link name="l"><inertial>{inertial}</inertial></link>'
    (place / "part.urdf").write_text(f'<robot name="r">{link}</robot>')
    gate = 'scenario = "mine"\nengine = "reference"\nmethod = "rk4"\nmeasure = "energy_drift"\nupper = 1.0\n'
    (place / "gates.toml").write_text(f'[[gate]]\n{gate}reason = "small"\n')
    return place


def _environment(tmp_path: Path, cache: Path) -> dict[str, str]:
    """Return the environment of a command whose Pythons log what they open in the hostile folder."""
    hook = tmp_path / "hook"
    hook.mkdir()
    (hook / "sitecustomize.py").write_text(HOOK)
    return {
        **os.environ,
        "PYTHONPATH": str(hook),
        "HOSTILE_FOLDER": str(tmp_path / "hostile"),
        "HOSTILE_LOG": str(tmp_path / "opened"),
        "BODYCHECK_CACHE_DIR": str(cache),
        "UV_OFFLINE": "1",
        "UV_CACHE_DIR": str(tmp_path / "uv"),  # or an engine that is in it would be installed, and removed
        "MPLCONFIGDIR": str(tmp_path),
    }


@pytest.mark.parametrize(
    ("commands", "caches"),
    [
        pytest.param(READ_FILES, "warm", marks=pytest.mark.nightly, id="warm"),
        pytest.param(set(COMMANDS), "warm", marks=pytest.mark.nightly, id="all-warm"),
        pytest.param(set(COMMANDS), "cold", marks=pytest.mark.nightly, id="all-cold"),
    ],
)
def test_commands_open_no_settings_and_no_modules_of_the_working_directory(
    commands: set[str], caches: str, folder: Path, tmp_path: Path
) -> None:
    """Each command ends as elsewhere, and the Pythons that it starts open only its inputs and outputs."""
    from bodycheck._util.cache_dir import cache_dir

    cache = tmp_path / "cache"
    if caches == "warm":
        shutil.copytree(cache_dir() / "kernels", cache / "kernels", dirs_exist_ok=True)
    environment = _environment(tmp_path, cache)
    program = Path(sys.executable).with_name("bodycheck")
    ran, statuses = [], {}
    for name, words in COMMANDS.items():
        if name not in commands:
            continue
        done = subprocess.run(
            [program, *words], cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        statuses[name] = done.returncode
        if name == "truth":
            (folder / "made/truth.csv").write_text(done.stdout)
        if (folder / "RAN").exists():
            ran.append(name)
            (folder / "RAN").unlink()
        if name not in NEEDS_NETWORK and name not in ("history accept", "history withdraw", "merge"):
            assert done.returncode in (0, 1, 3), f"{name}: {done.stderr}"
    lines = [line.split("\t") for line in (tmp_path / "opened").read_text().splitlines()]
    hostile = {f"{name}.py" for name in MODULES} | SETTINGS.keys() | {".git/config", "__pycache__"}
    opened = {path for path, _ in lines}
    assert not ran, f"started or imported something: {ran}"
    assert [line for line in lines if line[0] in hostile] == []
    assert opened >= INPUTS - {"part.urdf"}, statuses
