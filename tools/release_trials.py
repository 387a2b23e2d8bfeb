"""Build the distribution and test its wheel in new environments: extras, Pythons, lowest versions, sizes.

    python tools/release_trials.py python3.11 python3.12 python3.13
    python tools/release_trials.py --lowest python3.11 python3.12
    python tools/release_trials.py --resolve 3.14

Builds the sdist and the wheel from it twice, which must give the same bytes, and checks them with twine,
check-wheel-contents and pyroma. For each Python given, an environment without extras and one with each of
[engines], [history] and [all] is made of the wheel, with a cache of its own: help, completion, the lists and
doctor must work; the smoke suite (without engines: on the reference), `judge` and the pytest fixture must
pass; with [history], two nightly runs and a query. Prints the size of site-packages without pip and bytecode.

--lowest installs [all] with every direct dependency at its lowest allowed version that has a wheel for that
Python. --resolve only finds out whether all of [all] has wheels for a Python that is not installed here.

Needs a package index. Exit status 1 if a check failed.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from trials import ROOT, FaultFound, command

UNWANTED = shutil.ignore_patterns(
    ".venv",
    ".mypy_cache",
    ".pytest_cache",
    ".ruff_cache",
    ".hypothesis",
    "dist",
    "_build",
    "__pycache__",
    "bodycheck-runs",
)
EXTRAS = ("", "[engines]", "[history]", "[all]")
COMPLETION = "bodycheck --show-completion; exit $?"  # with one command bash would be replaced by it
ENDED_WELL = {"ok", "unsupported"}
_FIXTURE = """def test_fixture(bodycheck):
    found = bodycheck.run("free-flight", engine="reference", method="rk4", dt_s=[1e-2])
    found.check("orientation_error_rad", upper=1e-3)
"""
_EPOCH = "1700000000"


def printed(*words: str | Path, folder: Path, **environment: str) -> str:
    """Run a command and return its output; raise an error if its status is not 0."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        words, cwd=folder, env={**kept, **environment}, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        command = " ".join(map(str, words))
        raise FaultFound(f"{command}: status {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.stdout


def must(held: bool, what: str) -> None:
    """Raise an error if a condition does not hold."""
    if not held:
        raise FaultFound(what)


def uv(*words: str | Path, folder: Path) -> str:
    """Run uv, which downloads no Python."""
    return printed(sys.executable, "-m", "uv", "--quiet", *words, folder=folder, UV_PYTHON_DOWNLOADS="never")


def built(folder: Path) -> Path:
    """Build the distribution twice from a copy of the tree, check it, and return the wheel."""
    source, made = folder / "source", folder / "dist"
    shutil.copytree(ROOT, source, symlinks=True, ignore=UNWANTED)
    for place in (made, folder / "again"):
        printed(
            *(sys.executable, "-m", "build", "--outdir", place, source),
            folder=folder,
            SOURCE_DATE_EPOCH=_EPOCH,
        )
    for archive in made.iterdir():
        must(
            archive.read_bytes() == (folder / "again" / archive.name).read_bytes(), f"{archive.name} differs"
        )
    (wheel,), (sdist,) = made.glob("*.whl"), made.glob("*.tar.gz")
    printed(sys.executable, "-m", "twine", "check", "--strict", wheel, sdist, folder=folder)
    programs = Path(sys.executable).parent
    printed(programs / "check-wheel-contents", "--config", ROOT / "pyproject.toml", wheel, folder=folder)
    printed(programs / "pyroma", "--min=10", sdist, folder=folder)
    print(f"{wheel.name}, {sdist.name}: twice the same bytes; twine, check-wheel-contents and pyroma pass")
    return wheel


def size_mb(environment: Path) -> float:
    """Return the size of site-packages without pip and bytecode, in MB."""
    (site,) = environment.glob("lib/python*/site-packages")
    files = (path for path in site.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return sum(path.stat().st_size for path in files if path.relative_to(site).parts[0] != "pip") / 1e6


def environment_of(python: str, wheel: Path, extra: str, folder: Path, *options: str) -> Path:
    """Make an environment of the wheel with an extra and pytest, and return it."""
    folder.mkdir()
    uv("venv", "--python", python, folder / "env", folder=folder)
    requirement = f"bodycheck{extra} @ {wheel.as_uri()}"
    install = ("pip", "install", "--python", folder / "env/bin/python", "--only-binary", ":all:")
    uv(*install, *options, requirement, folder=folder)
    return folder / "env"


def tried(environment: Path, extra: str, folder: Path) -> str:
    """Test an environment; return a summary."""
    programs = environment / "bin"
    size = size_mb(environment)
    uv("pip", "install", "--python", programs / "python", "pytest", folder=folder)
    variables = {
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "BODYCHECK_CACHE_DIR": str(folder / "cache"),
    }

    def bodycheck(*words: str | Path) -> str:
        return printed(programs / "bodycheck", *words, folder=folder, **variables)

    _starts(bodycheck, programs, folder, variables)
    begin = time.monotonic()
    bodycheck("run", "smoke", "--no-speed", "--out", "run")
    seconds = time.monotonic() - begin
    must((folder / "run/report.html").stat().st_size > 1e6, "no report")
    manifest = json.loads((folder / "run/manifest.json").read_text(encoding="utf-8"))
    must(set(manifest["outcomes"]) <= ENDED_WELL, f"outcomes {manifest['outcomes']}")
    measured = [
        f"{name} {facts['version']}" for name, facts in manifest["engines"].items() if "version" in facts
    ]
    must((len(measured) > 2) == (extra in ("[engines]", "[all]")), f"{extra}: measured {measured}")
    (folder / "true.csv").write_text(bodycheck("truth", "free-flight", "--at", "0,0.5,1"), encoding="utf-8")
    bodycheck("judge", "true.csv", "--scenario", "free-flight")
    (folder / "test_fixture.py").write_text(_FIXTURE, encoding="utf-8")
    printed(programs / "python", "-m", "pytest", "-q", "test_fixture.py", folder=folder, **variables)
    if extra in ("[history]", "[all]"):
        _keeps_history(bodycheck, folder)
    return f"{size:.0f} MB; {manifest['outcomes']} in {seconds:.0f} s, from nothing; {', '.join(measured)}"


def _starts(bodycheck: Callable[..., str], programs: Path, folder: Path, variables: dict[str, str]) -> None:
    """Check help, completion, the lists and doctor."""
    module_help = printed(programs / "python", "-m", "bodycheck", "--help", folder=folder, **variables)
    must(all("Measure:" in text for text in (bodycheck("--help"), module_help)), "no help")
    script = printed("bash", "-c", COMPLETION, folder=folder, **variables)
    must("_BODYCHECK_COMPLETE=complete_bash" in script, f"no completion: {script}")
    requested = {"_BODYCHECK_COMPLETE": "complete_bash", "COMP_WORDS": "bodycheck ru", "COMP_CWORD": "1"}
    completed = printed(programs / "bodycheck", folder=folder, **variables, **requested)
    must(completed.split() == ["run"], f"bodycheck ru is completed to {completed!r}")
    for what in ("scenarios", "suites", "engines", "methods", "measures"):
        must(bool(bodycheck("list", what)), f"bodycheck list {what} says nothing")
    must(bool(json.loads(bodycheck("doctor", "--json"))["checks"]), "doctor finds nothing")


def _keeps_history(bodycheck: Callable[..., str], folder: Path) -> None:
    """Check two nightly runs, whose status is 3 and then 0, and a query."""
    words = ("nightly", "free-flight", "--history", "nights", "--engine", "reference:rk4", "--no-speed")
    try:
        bodycheck(*words)
        raise FaultFound("the first nightly run has a baseline")
    except FaultFound as first:
        must("status 3" in str(first), str(first))
    bodycheck(*words)
    counted = bodycheck("history", "query", "nights", "SELECT count(*) AS n FROM nights", "--format", "json")
    must(json.loads(counted)[0]["n"] == 2, f"the history has {counted}")
    must((folder / "nights").is_dir(), "no history")


def main(*pythons: str, lowest: bool = False, resolve: bool = False) -> int:
    """Test each Python, with lowest or resolve only [all]; return the number of failures."""
    failed = 0
    with tempfile.TemporaryDirectory(prefix="release-trials-") as place:
        wheel = None if resolve else built(Path(place))
        for python in pythons:
            for extra in EXTRAS[-1:] if lowest or resolve else EXTRAS:
                folder = Path(place, f"{python.replace('/', '-')}{extra}")
                options = ("--resolution", "lowest-direct") if lowest else ()
                try:
                    if wheel is None:
                        versions = ("--python-version", python, "--only-binary", ":all:")
                        compiled = ("pip", "compile", *versions, "--extra", "all", ROOT / "pyproject.toml")
                        uv(*compiled, folder=Path(place))
                        summary = "there are wheels for everything"
                    else:
                        environment = environment_of(python, wheel, extra, folder, *options)
                        summary = tried(environment, extra, folder)
                    print(f"{python} {extra or 'no extra'}: {summary}", flush=True)
                except (FaultFound, OSError) as fault:
                    failed += 1
                    print(f"{python} {extra or 'no extra'}: {fault}", flush=True)
                shutil.rmtree(folder, ignore_errors=True)
    return failed


if __name__ == "__main__":
    command(main)
