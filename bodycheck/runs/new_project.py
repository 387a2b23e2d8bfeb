"""The files that make a project's build server check an engine: gates and a workflow."""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck._util.untrusted import shell_join
from bodycheck.adapters.engine_names import admit, engine_fault, is_command, split_method
from bodycheck.adapters.registry import engine_names
from bodycheck.runs.schemas import address, schema_of

_GATES = """#:schema {schema}
# Bounds on the results of {engine}; docs/gates.md of bodycheck lists the measures.

[[gate]]
engine = {engine_text}{method}
measure = "outcome"
equals = "ok"
reason = "every case runs to its end"

[[gate]]
engine = {engine_text}{method}
measure = "orientation_error_rad"
upper = 1.0
reason = "a wide bound to begin with; bodycheck gate --update tightens it to what the engine meets"

[[gate]]
engine = {engine_text}{method}
measure = "energy_drift"
upper = 1.0
reason = "the same"
"""

_WORKFLOW = """# Written by `bodycheck init`: checks the engine at each push and pull request.
name: bodycheck
on:
  push:
    branches: [main]
  pull_request:

permissions:
  contents: read

jobs:
  bodycheck:
    runs-on: ubuntu-24.04
    timeout-minutes: 30
    steps:
      - uses: actions/checkout@11bd71901bbe5b1630ceea73d27597364c9af683 # v4.2.2
        with:
          persist-credentials: false
{build}      - uses: bodycheck/bodycheck@v{version}
        with:
          engine: {engine}
          gates: gates.toml
          baseline: true
{audit}"""

_BUILD = """      - name: Build the engine
        run: make
"""


def new_project(folder: Path, engine: str) -> tuple[list[Path], list[Path], list[str]]:
    """Write gates.toml and the workflow into a folder, unless they exist.

    Returns the files that were written, those that existed, and the commands that come next. Raises
    InputError if the name of the engine is wrong, or the folder does not exist or cannot be written.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: is not a folder")
    name, _, method = split_method(engine)
    if is_command(name):
        admit([engine], allow_code=True)
    elif fault := engine_fault(name):
        raise InputError(f"--engine {fault}")
    models = [f"**/*.{suffix}" for suffix in ("urdf", "sdf") if any(folder.rglob(f"*.{suffix}"))]
    texts = {
        folder / "gates.toml": _GATES.format(
            schema=address(schema_of("gates")),
            engine=engine,
            engine_text=json.dumps(name),
            method=f"\nmethod = {json.dumps(method)}" if method else "",
        ),
        folder / ".github/workflows/bodycheck.yml": _WORKFLOW.format(
            version=version("bodycheck"),
            engine=json.dumps(engine),
            build="" if name in engine_names() else _BUILD,
            audit=f"          audit: '{' '.join(models)}'\n" if models else "",
        ),
    }
    kept = [path for path in texts if path.exists()]
    written = [path for path in texts if path not in kept]
    for path in written:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(texts[path], encoding="utf-8")
        except OSError as error:
            raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    gates = str(folder / "gates.toml")
    check = shell_join(["bodycheck", "gate", "smoke", "--gates", gates])
    again = shell_join(["bodycheck", "gate", "smoke", "--gates", gates, "--update"])
    return written, kept, [check, again]
