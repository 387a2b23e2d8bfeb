"""Build and check the distribution, and test its wheel in an empty environment of each Python.

    python tools/wheel_trials.py python3.11 python3.12 python3.13

Builds the sdist, and the wheel from it; each must pass `twine check --strict`. For each Python given, only
the wheel is installed in a new environment with its own cache; help, completion and the lists must work, and
the smoke suite must end with a report and without a failed case. Prints one line each. Exit status 1 if a
check failed. Needs twine in addition to the test extra, and a package index.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
UNWANTED = shutil.ignore_patterns(
    ".*", "build", "dist", "_build", "*.egg-info", "__pycache__", "bodycheck-runs"
)
COMPLETION = "bodycheck --show-completion; exit $?"  # with one command bash would be replaced by it
ENDED_WELL = {"ok", "unsupported"}


class NotAsItShould(Exception):  # noqa: N818 - the result that the trials search for
    """A command that did not do what is required."""


def printed(*words: str | Path, folder: Path, **environment: str) -> str:
    """Run a command and return its output; raise an error if its status is not 0."""
    reported = {
        name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")
    }
    done = subprocess.run(
        words, cwd=folder, env={**reported, **environment}, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        command = " ".join(map(str, words))
        raise NotAsItShould(
            f"{command}: status {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
        )
    return done.stdout


def must(held: bool, what: str) -> None:
    """Raise an error if a condition does not hold."""
    if not held:
        raise NotAsItShould(what)


def built(folder: Path) -> Path:
    """Build and check the distribution from a copy of the tree, and return the wheel."""
    source, made = folder / "source", folder / "dist"
    shutil.copytree(ROOT, source, symlinks=True, ignore=UNWANTED)
    printed(sys.executable, "-m", "build", "--outdir", made, source, folder=folder)
    (wheel,) = made.glob("*.whl")
    printed(sys.executable, "-m", "twine", "check", "--strict", *made.iterdir(), folder=folder)
    print(f"{' and '.join(sorted(path.name for path in made.iterdir()))}: built, and twine has no complaint")
    return wheel


def tried(python: str, wheel: Path, folder: Path) -> str:
    """Install the wheel in an empty environment and test it; return a summary."""
    folder.mkdir()
    printed(python, "-m", "venv", folder / "env", folder=folder)
    programs = folder / "env" / "bin"
    environment = {
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "BODYCHECK_CACHE_DIR": str(folder / "cache"),
    }

    def bodycheck(*words: str | Path) -> str:
        return printed(programs / "bodycheck", *words, folder=folder, **environment)

    printed(programs / "python", "-m", "pip", "install", "--quiet", wheel, folder=folder)
    help_text = bodycheck("--help")
    module_help = printed(programs / "python", "-m", "bodycheck", "--help", folder=folder, **environment)
    must(all("Commands:" in text for text in (help_text, module_help)), "no help")
    script = printed("bash", "-c", COMPLETION, folder=folder, **environment)
    must("_BODYCHECK_COMPLETE=complete_bash" in script, f"no completion: {script}")
    requested = {"_BODYCHECK_COMPLETE": "complete_bash", "COMP_WORDS": "bodycheck ru", "COMP_CWORD": "1"}
    completed = printed(programs / "bodycheck", folder=folder, **environment, **requested)
    must(completed.split() == ["run"], f"bodycheck ru is completed to {completed!r}")
    for what in ("scenarios", "suites", "engines", "methods", "measures"):
        must(bool(bodycheck("list", what)), f"bodycheck list {what} says nothing")
    begin = time.monotonic()
    bodycheck("run", "smoke", "--out", "run")
    seconds = time.monotonic() - begin
    must((folder / "run/report.html").stat().st_size > 1e6, "no report")
    manifest = json.loads((folder / "run/manifest.json").read_text(encoding="utf-8"))
    must(set(manifest["outcomes"]) <= ENDED_WELL, f"outcomes {manifest['outcomes']}")
    engines = (
        f"{name} {facts.get('version', 'is not there')}" for name, facts in manifest["engines"].items()
    )
    return f"{manifest['outcomes']} in {seconds:.0f} s, from nothing; {', '.join(engines)}"


def main() -> int:
    """Test every Python that is given."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("python", nargs="+")
    failed = 0
    with tempfile.TemporaryDirectory(prefix="wheel-trials-") as place:
        wheel = built(Path(place))
        for number, python in enumerate(options.parse_args().python):
            folder = Path(place, str(number))
            try:
                version = printed(python, "--version", folder=Path(place)).strip()
                print(f"{version}: {tried(python, wheel, folder)}", flush=True)
            except (NotAsItShould, OSError) as fault:
                failed += 1
                print(f"{python}: {fault}", flush=True)
            shutil.rmtree(folder, ignore_errors=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
