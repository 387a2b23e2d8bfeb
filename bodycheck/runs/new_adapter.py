"""Write the package of a new adapter: a working example to be replaced piece by piece, with its tests."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

from bodycheck._util.errors import InputError
from bodycheck.adapters import example
from bodycheck.adapters.registry import engine_names

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")

_PYPROJECT = """[build-system]
requires = ["setuptools>=77"]
build-backend = "setuptools.build_meta"

[project]
name = "bodycheck-{name}"
version = "0.1.0"
description = "bodycheck's adapter of {name}"
requires-python = ">=3.11"
dependencies = ["bodycheck>={bodycheck}"] # and the engine

[project.optional-dependencies]
test = ["pytest"]

[project.entry-points."bodycheck.adapters"]
{name} = "{module}:{class_name}"

[tool.setuptools]
packages = ["{module}"]
"""

_TEST = '''"""The adapter obeys bodycheck's contract: the checks of `bodycheck check-adapter {name}`."""

import bodycheck
import pytest
from bodycheck.runs.engine_checks import check_adapter

from {module} import {class_name}


@pytest.fixture(scope="session")
def conformance():
    """Return the results of all checks."""
    bodycheck.register_adapter({class_name}())
    return check_adapter("{name}", timeout_s=60.0)


def test_contract(conformance) -> None:
    """No check fails; a message says what is wrong."""
    assert [f"{{result.check}}: {{result.message}}" for result in conformance.failures] == []


def test_motions_are_checked(conformance) -> None:
    """Readings, loads, reset and steps are measured, not only refused."""
    measured = {{result.check for result in conformance.results if result.verdict == "consistent"}}
    assert {{"model", "read-back", "readings", "loads", "reset", "advance"}} <= measured
'''


def new_adapter(name: str) -> Path:
    """Write the package into ./bodycheck-NAME and return that folder.

    Raises InputError if the name is invalid or taken, or the folder exists or cannot be written.
    """
    if _NAME.fullmatch(name) is None:
        raise InputError(f"{name}: not a name of an engine (expected lower case, like my-engine)")
    if name in engine_names():
        raise InputError(f"{name}: is the name of an engine or adapter that is installed")
    folder = Path(f"bodycheck-{name}")
    if folder.exists():
        raise InputError(f"{folder}: exists already")
    try:
        unfinished = Path(tempfile.mkdtemp(prefix=f".{folder}-", dir="."))
        try:
            unfinished.chmod(0o755)
            for file_name, text in _files(name).items():
                path = unfinished / file_name
                path.parent.mkdir(exist_ok=True)
                path.write_text(text, encoding="utf-8")
            unfinished.rename(folder)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from None
    return folder


def _files(name: str) -> Mapping[str, str]:
    """Return the texts of the package by their places."""
    values = {
        "name": name,
        "module": f"bodycheck_{name.replace('-', '_')}",
        "class_name": "".join(part.capitalize() for part in name.split("-")),
        "bodycheck": version("bodycheck"),
    }
    return {
        "pyproject.toml": _PYPROJECT.format(**values),
        f"{values['module']}/__init__.py": _adapter(values["name"], values["class_name"]),
        "tests/test_adapter.py": _TEST.format(**values),
    }


def _adapter(name: str, class_name: str) -> str:
    """Return the example under another name, without the remarks for the linter."""
    source = Path(example.__file__).read_text(encoding="utf-8")
    source = re.sub(r"  # noqa[^\n]*", "", source)
    first, _, rest = source.partition("\n")
    del first
    source = f'"""The adapter of {name}: replace the steps of the example by calls of the engine."""\n{rest}'
    return (
        source.replace("Example", class_name)
        .replace('"example"', f'"{name}"')
        .replace("bodycheck-example", f"bodycheck-{name}")
    )
