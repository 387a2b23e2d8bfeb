"""Write a new adapter: a working example to be replaced piece by piece, in Python, C or Rust."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Mapping
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Literal, TypeAlias

from bodycheck._util.errors import InputError
from bodycheck.adapters import example, example_trees
from bodycheck.adapters.registry import engine_names

Language: TypeAlias = Literal["python", "c", "rust"]

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


_CARGO = """[package]
name = "{name}"
version = "0.1.0"
edition = "2021"
"""


def new_adapter(
    name: str, language: Language = "python", *, tree: bool = False
) -> tuple[Path, tuple[str, ...]]:
    """Write a package in Python, or a worker in C or Rust, into ./bodycheck-NAME.

    tree: also write a model of trees, in Python. Returns that folder, and the commands that build and check
    the adapter. Raises InputError if the name is invalid or taken, or the folder exists or cannot be written.
    """
    if tree and language != "python":
        raise InputError(f"--tree: a worker in {language} reports nothing of trees; use --language python")
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
            for file_name, text in _files(name, language, tree=tree).items():
                path = unfinished / file_name
                path.parent.mkdir(exist_ok=True)
                path.write_text(text, encoding="utf-8")
            unfinished.rename(folder)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from None
    return folder, _commands(name, folder, language)


def _commands(name: str, folder: Path, language: Language) -> tuple[str, ...]:
    """Return the commands that build and check what was written."""
    if language == "python":
        return f"pip install -e {folder}", f"bodycheck check-adapter {name}"
    if language == "c":
        build, program = f"cc -O2 -o {folder}/{name} {folder}/{name}.c -lm", folder / name
    else:
        build = f"cargo build --release --manifest-path {folder}/Cargo.toml"
        program = folder / "target/release" / name
    return build, f"bodycheck check-adapter cmd:{program}"


def _files(name: str, language: Language, *, tree: bool) -> Mapping[str, str]:
    """Return the texts of an adapter by their places."""
    if language == "c":
        return {f"{name}.c": _worker("worker.c", name)}
    if language == "rust":
        return {"Cargo.toml": _CARGO.format(name=name), "src/main.rs": _worker("worker.rs", name)}
    values = {
        "name": name,
        "module": f"bodycheck_{name.replace('-', '_')}",
        "class_name": "".join(part.capitalize() for part in name.split("-")),
        "bodycheck": version("bodycheck"),
    }
    written = {
        "pyproject.toml": _PYPROJECT.format(**values),
        f"{values['module']}/__init__.py": _adapter(values["name"], values["class_name"]),
        "tests/test_adapter.py": _TEST.format(**values),
    }
    return {**written, **_of_trees(values, written)} if tree else written


def _of_trees(values: Mapping[str, str], written: Mapping[str, str]) -> Mapping[str, str]:
    """Return the file of the model of trees, and the adapter that has it."""
    module, model = values["module"], f"{values['class_name']}Tree"
    _, _, rest = Path(example_trees.__file__).read_text(encoding="utf-8").partition("\n")
    head = f'"""Trees in {values["name"]}: replace the exact dynamics by calls of the engine."""\n'
    adapter = written[f"{module}/__init__.py"].replace(
        "\n\n\nclass", f"\nfrom {module}.trees import {model}\n\n\nclass", 1
    )
    methods = "    methods = "
    adapter = adapter.replace(methods, f"    tree_model = {model}\n{methods}", 1)
    return {
        f"{module}/__init__.py": adapter,
        f"{module}/trees.py": head + rest.replace("ExampleTree", model),
    }


def _worker(file: str, name: str) -> str:
    """Return the worker of the engine `example` under another name."""
    text = (files("bodycheck.adapters") / "skeletons" / file).read_text(encoding="utf-8")
    return re.sub(r"\bexample\b", name, text)


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
