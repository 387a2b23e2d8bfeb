"""The package imports nothing expensive early, and the distribution has the files of the source tree.

Ruff checks docstrings and annotations, import-linter the direction of imports (pyproject.toml).
"""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.helpers.expected_messages import ExpectedMessage

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "bodycheck"
ROOMS = ("reference_impl", "scenarios", "adapters", "reports")
Definition = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def test_the_rooms_are_linked_at_the_top_level() -> None:
    """The four packages are links at the top level, where links survive a checkout."""
    for room in ROOMS:
        link = ROOT / room
        if not link.is_symlink():
            pytest.skip("this checkout has no symbolic links")
        assert link.resolve() == PACKAGE / room


def test_no_module_name_stands_twice() -> None:
    """Each module name is unique, so a module can be found by its name alone."""
    names = Counter(path.stem for path in PACKAGE.rglob("*.py") if not path.stem.startswith("__"))
    assert [name for name, count in names.items() if count > 1] == []


def test_no_public_class_name_stands_twice() -> None:
    """The name of a public class has one meaning."""
    homes: dict[str, list[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(str(path.relative_to(PACKAGE)))
    assert {name: files for name, files in homes.items() if len(files) > 1} == {}


HEAVY = ("numba", "numpy", "pandas", "scipy", "jinja2", "mujoco", "pybullet", "dartpy", "pydantic")


@pytest.mark.parametrize("what", ["import bodycheck", "import bodycheck.cli.commands"])
def test_heavy_imports_are_late(what: str) -> None:
    """Neither the package nor its command line imports an expensive module until it is needed."""
    code = f"{what}\nimport sys\nprint([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_run_starts_without_what_few_runs_need() -> None:
    """The first imports of a run include neither the compiler nor the readers of model files."""
    code = (
        "import sys, bodycheck.runs.directory\n"
        "import bodycheck.reports.render.progress, bodycheck.reports.summary.sentences\n"
        "assert 'pydantic' in sys.modules\n"
        "print([name for name in ('numba', 'lxml', 'mpmath', 'scipy', 'pandas') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_worker_starts_without_what_only_a_run_needs() -> None:
    """An engine's process does not import the library that checks its answers."""
    needless = tuple(name for name in HEAVY if name != "numpy")
    code = (
        "import sys, bodycheck.adapters.workers.worker\n"
        f"print([name for name in {needless!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_public_names_exist_and_are_documented(expected_message: ExpectedMessage) -> None:
    """Every name of the lazy public interface exists, and an unknown name raises AttributeError."""
    import bodycheck

    for name in bodycheck.__all__:
        assert getattr(bodycheck, name).__doc__
    assert set(bodycheck.__all__) <= set(dir(bodycheck))
    with expected_message.raises(AttributeError):
        bodycheck.nothing  # noqa: B018 - reading the attribute is the test


def defined(node: ast.AST, public: bool = True) -> Iterator[tuple[Definition, bool]]:
    """Yield the classes and functions within a node, and whether all names on the path to them are public."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, Definition):
            is_public = public and not child.name.startswith("_")
            yield child, is_public
            # names defined within a function are local to it
            yield from defined(child, is_public and isinstance(child, ast.ClassDef))
        else:
            yield from defined(child, public)


SHAPE = re.compile(r"\((?:\w+|\.\.\.),[^()]*\)|\(\.\.\.\)")
INTERFACE = re.findall(r"^\.\. automodule:: (\S+)$", (ROOT / "docs/api.md").read_text(), flags=re.MULTILINE)


@pytest.mark.parametrize("module", INTERFACE)
def test_arrays_of_the_documented_interface_have_their_shapes(module: str) -> None:
    """The docstring of each public function that takes or returns an array states its shape."""
    place = ROOT / module.replace(".", "/")
    path = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
    for node, public in defined(ast.parse(path.read_text())):
        if public and not isinstance(node, ast.ClassDef):
            annotations = f"{ast.unparse(node.args)} {ast.unparse(node.returns or ast.Constant(None))}"
            shape = SHAPE.search(ast.get_docstring(node) or "")
            assert shape or not re.search(r"\bArray\b", annotations), f"{path.name}: {node.name}"


@pytest.mark.nightly
def test_distribution_contains_exactly_the_package(tmp_path: Path) -> None:
    """The wheel, built from the sdist, has exactly the files of the source tree, including the meshes."""
    # a copy, because what git ignores may stand in a checkout
    source = tmp_path / "source"
    unwanted = shutil.ignore_patterns(".*", "build", "*.egg-info", "__pycache__", "bodycheck-runs", "_build")
    shutil.copytree(ROOT, source, symlinks=True, ignore=unwanted)
    command = [sys.executable, "-m", "build", "--outdir", str(tmp_path), str(source)]
    subprocess.run(command, check=True, capture_output=True)
    files = (p for p in PACKAGE.rglob("*") if p.is_file() and p.parent.name != "__pycache__")
    tree = {p.relative_to(ROOT).as_posix() for p in files}
    (wheel,) = tmp_path.glob("*.whl")
    inside = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert inside == tree
    (sdist,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        sources = {member.name.partition("/")[2] for member in archive if not member.isdir()}
    beside = {"CHANGELOG.md", "CITATION.cff", "LICENSE", "README.md", "pyproject.toml", "PKG-INFO"}
    assert sources == tree | beside
    unpacked = tmp_path / "unpacked"
    zipfile.ZipFile(wheel).extractall(unpacked)
    code = "import bodycheck; print(bodycheck.__file__, bodycheck.load_scenario('t-handle').body.mass_kg)"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        env={**os.environ, "PYTHONPATH": str(unpacked)},
        check=True,
        capture_output=True,
        text=True,
    )
    where, mass_kg = done.stdout.split()
    assert where == str(unpacked / "bodycheck/__init__.py")
    assert float(mass_kg) == pytest.approx(0.162, rel=1e-15, abs=0.0)  # the sum of its two bars is exact
