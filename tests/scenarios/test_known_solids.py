"""Solids of meshes are worked out once: what is on disk is the same to the last bit, or is not believed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bodycheck.reference_impl.mass_properties.solid import MassProperties
from bodycheck.scenarios import shapes
from bodycheck.scenarios.shapes import known_solid

SOLID = MassProperties(
    1.0 / 3.0, np.array([0.1, -1e-300, 2.0 / 7.0]), np.diag([1.0, 2.0, 2.5]) / 3.0, ("a note",)
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the empty folder in which solids are kept."""
    monkeypatch.setattr(shapes, "cache_directory", lambda: tmp_path)
    return tmp_path / "solids"


def asked(name: str = "abc.stl") -> tuple[MassProperties, int]:
    """Return the solid of a file, and how often it was worked out."""
    times: list[str] = []

    def work_out() -> MassProperties:
        times.append(name)
        return SOLID

    return known_solid(name, work_out), len(times)


def test_a_solid_is_worked_out_once(folder: Path) -> None:
    """The second time all its numbers and notes come from disk, equal to the last bit; another's do not."""
    assert asked()[1] == 1
    found, times = asked()
    assert times == 0
    assert (found.mass, found.notes) == (SOLID.mass, SOLID.notes)
    assert found.centre.tobytes() == SOLID.centre.tobytes()
    assert found.inertia.tobytes() == SOLID.inertia.tobytes()
    assert asked("abc.obj")[1] == 1
    assert len(list(folder.iterdir())) == 2


@pytest.mark.parametrize("damage", ["cut", "changed", "empty"])
def test_a_damaged_solid_is_worked_out_again(damage: str, folder: Path) -> None:
    """What is not whole on disk counts as absent, and is put right."""
    asked()
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes({"cut": whole[:-9], "changed": whole.replace(b"0.1", b"0.2"), "empty": b""}[damage])
    assert asked()[1] == 1
    assert file.read_bytes() == whole


def test_a_folder_that_cannot_be_written_keeps_nothing(folder: Path) -> None:
    """The solid is worked out each time, and nobody is told of an error."""
    folder.write_text("a file where the folder should be")
    assert [asked()[1] for _ in range(2)] == [1, 1]
