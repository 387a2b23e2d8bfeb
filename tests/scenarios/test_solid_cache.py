"""Solids of meshes are cached: a stored solid equals the computed one bit for bit, or is ignored."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bodycheck.scenarios import shapes
from bodycheck.scenarios.mass_properties.solid import MassProperties
from bodycheck.scenarios.shapes import MeshFacts, known_mesh

SOLID = MassProperties(
    1.0 / 3.0, np.array([0.1, -1e-300, 2.0 / 7.0]), np.diag([1.0, 2.0, 2.5]) / 3.0, ("a note",)
)

FACTS = MeshFacts(SOLID, "v 0.0 0.0 0.0\n", "(1, 2, 3)", (0.1, 1.0 / 7.0))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the empty folder in which solids are stored."""
    monkeypatch.setattr(shapes, "cache_directory", lambda: tmp_path)
    return tmp_path / "solids"


def solid_and_computations(name: str = "abc.stl") -> tuple[MassProperties, int]:
    """Return the solid of a file, and how often it was computed."""
    times: list[str] = []

    def compute() -> MeshFacts:
        times.append(name)
        return FACTS

    found = known_mesh(name, compute)
    assert found[1:] == FACTS[1:]
    return found.solid, len(times)


def test_solid_is_computed_once(folder: Path) -> None:
    """The second time all numbers and notes come from the cache; another mesh has another entry."""
    assert solid_and_computations()[1] == 1
    found, times = solid_and_computations()
    assert times == 0
    assert (found.mass, found.notes) == (SOLID.mass, SOLID.notes)
    assert found.centre.tobytes() == SOLID.centre.tobytes()
    assert found.inertia.tobytes() == SOLID.inertia.tobytes()
    assert solid_and_computations("abc.obj")[1] == 1
    assert len(list(folder.iterdir())) == 2


@pytest.mark.parametrize("damage", ["cut", "changed", "empty"])
def test_damaged_solid_is_computed_again(damage: str, folder: Path) -> None:
    """A damaged entry counts as absent and is replaced."""
    solid_and_computations()
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes({"cut": whole[:-9], "changed": whole.replace(b"0.1", b"0.2"), "empty": b""}[damage])
    assert solid_and_computations()[1] == 1
    assert file.read_bytes() == whole


def test_cache_that_cannot_be_written_is_ignored(folder: Path) -> None:
    """The solid is computed each time, and no error is reported."""
    folder.write_text("a file where the folder should be")
    assert [solid_and_computations()[1] for _ in range(2)] == [1, 1]
