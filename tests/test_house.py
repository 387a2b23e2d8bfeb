"""The house: imports run one way, nothing heavy is imported early, the wheel holds what the tree holds."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "bodycheck"
ROOMS = ("reference_impl", "scenarios", "adapters", "reports")
FRONT_DOOR = len(ROOMS)
SHARED = {"errors"}  # the error tree belongs to everybody


def modules() -> list[Path]:
    """Return every module of the package."""
    return sorted(PACKAGE.rglob("*.py"))


def imported_names(path: Path) -> set[str]:
    """Return the absolute names that a module imports, wherever it does so."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module or ""}
    return names


def level(module: str) -> int:
    """Return the room's place on the one-way street; the front door comes last."""
    parts = module.split(".")
    return ROOMS.index(parts[1]) if len(parts) > 1 and parts[1] in ROOMS else FRONT_DOOR


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(ROOT)))
def test_imports_run_one_way(path: Path) -> None:
    """No room imports from a later one, nor from the front door; the bare room names are never imported."""
    own = level(".".join(path.relative_to(ROOT).with_suffix("").parts))
    for name in imported_names(path):
        assert name.split(".")[0] not in ROOMS, f"{name} is somebody else's package on PyPI"
        parts = name.split(".")
        if parts[0] == "bodycheck" and len(parts) > 1 and parts[1] not in SHARED:
            assert level(name) <= own, f"{path} imports {name}"


def test_the_rooms_are_linked_at_the_top_level() -> None:
    """The four rooms stand at the top as links into the package, where links survive a checkout."""
    for room in ROOMS:
        link = ROOT / room
        if not link.is_symlink():
            pytest.skip("this checkout has no symbolic links")
        assert link.resolve() == PACKAGE / room


HEAVY = ("numba", "numpy", "pandas", "scipy", "jinja2", "mujoco", "pybullet", "dartpy", "pydantic")


@pytest.mark.parametrize("what", ["import bodycheck", "import bodycheck.cli"])
def test_heavy_imports_happen_late(what: str) -> None:
    """Neither the package nor its command line imports anything heavy until it is needed."""
    code = f"{what}\nimport sys\nprint([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_public_names_come_from_their_homes() -> None:
    """Every name of the lazy public interface is there and documented; a wrong one is an AttributeError."""
    import bodycheck

    for name in bodycheck.__all__:
        assert getattr(bodycheck, name).__doc__
    assert set(bodycheck.__all__) <= set(dir(bodycheck))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        bodycheck.nothing  # noqa: B018 - reading it is the test


@pytest.mark.slow
def test_the_wheel_holds_the_package_and_nothing_else(tmp_path: Path) -> None:
    """The wheel's files are the tree's, no links, no tests; unpacked, it finds its meshes."""
    # built from a copy: setuptools leaves build/ behind, and would put stale files of it into the next wheel
    source = tmp_path / "source"
    unwanted = shutil.ignore_patterns(".*", "build", "*.egg-info", "__pycache__", "tests", "bodycheck-runs")
    shutil.copytree(ROOT, source, symlinks=True, ignore=unwanted)
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "-w", str(tmp_path), str(source)]
    subprocess.run(command, check=True, capture_output=True)
    (wheel,) = tmp_path.glob("*.whl")
    inside = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    kept = {".py", ".toml", ".typed", ".html", ".css", ".js", ".obj", ".txt"}
    tree = {p.relative_to(ROOT).as_posix() for p in PACKAGE.rglob("*") if p.suffix in kept}
    assert inside == tree | {"bodycheck/py.typed"}
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
    assert float(mass_kg) == pytest.approx(0.162, rel=1e-15)  # of its two bars, without rounding


MATHEMATICS = {"numpy", "numba", "bodycheck", *sys.stdlib_module_names}


@pytest.mark.parametrize(
    "path", sorted((PACKAGE / "reference_impl").rglob("*.py")), ids=lambda path: path.name
)
def test_the_reference_is_from_scratch(path: Path) -> None:
    """reference_impl knows numpy and numba, and no other library."""
    assert {name.split(".")[0] for name in imported_names(path) if name} <= MATHEMATICS
