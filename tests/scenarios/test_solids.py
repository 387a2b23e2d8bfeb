"""Solids as the command line specifies them: meshes, shapes and level sets of users."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bodycheck._util.errors import InputError
from bodycheck.scenarios.level_sets import Estimate
from bodycheck.scenarios.mass_properties.solid import PRIMITIVES, MassProperties
from bodycheck.scenarios.shapes import primitive
from bodycheck.scenarios.solids import SolidRequest, as_toml, mass_properties
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.scenario_parsing import parse_scenario

TORUS = (1.0, 0.3)
AROUND = (-1.4, -0.4, -1.4, 1.4, 0.4, 1.4)  # the torus about y

USERS = """
import sys

import numpy as np


def ring(points):
    x, y, z = points.T
    return (np.hypot(x, z) - 1.0) ** 2 + y**2 - 0.09


def careless(points):
    points *= 2.0
    x, y, z = 0.5 * points.T
    return np.maximum(np.abs(z - 0.005) - 0.003, np.maximum(np.abs(x), np.abs(y)) - 0.3)


def counted(points):
    return (np.linalg.norm(points, axis=1) > 0.35).astype(int)


def slab(points):
    return np.abs(points[:, 2]) - 0.25


def raising(points):
    raise ZeroDivisionError("by\\nnought")


def leaving(points):
    sys.exit(3)


def mask(points):
    return points[:, 0] < 0.0


def words(points):
    return ["out"] * len(points)


def waves(points):
    return points[:, 0] + 1j


def nothing(points):
    return None


def one(points):
    return -1.0


def gap(points):
    return np.where(points[:, 0] > 0.0, np.nan, -1.0)


def outside(points):
    return np.ones(len(points))


number = 3
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Work in a folder with a user's modules, and remove all traces of them afterwards."""
    (tmp_path / "users_shapes.py").write_text(USERS)
    (tmp_path / "broken_shapes.py").write_text("1 / 0\n")
    (tmp_path / "leaving_shapes.py").write_text("raise SystemExit(3)\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield tmp_path
    for name in ("users_shapes", "broken_shapes", "leaving_shapes"):
        sys.modules.pop(name, None)


def estimated(name: str, box: tuple[float, ...] = AROUND) -> Estimate:
    """Return the estimate for a function of the user's module at 7 kg/m^3."""
    found = mass_properties(SolidRequest(f"users_shapes:{name}", 7.0, box=box, allow_code=True))
    assert isinstance(found, Estimate)
    return found


def worst_deviation(found: Estimate, truth: MassProperties) -> float:
    """Return the largest error of mass, centre and inertia in units of its standard error."""
    known = found.inertia_error > 1e-12
    return max(
        abs(found.properties.mass - truth.mass) / found.mass_error,
        *(np.abs(found.properties.inertia - truth.inertia)[known] / found.inertia_error[known]),
    )


@pytest.mark.slow
def test_level_set_is_estimated_with_its_standard_errors() -> None:
    """A torus about y at 7 kg/m^3 is within 4 standard errors, each below 1e-3 of its total."""
    truth = primitive("torus", TORUS, 7.0).rotated(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))
    found = estimated("ring")
    assert worst_deviation(found, truth) < 4.0
    assert 0.0 < found.mass_error < 1e-3 * truth.mass
    assert np.max(found.inertia_error) < 1e-3 * np.max(truth.inertia)
    assert found.properties.notes == ()


@pytest.mark.slow
def test_level_set_may_modify_its_points() -> None:
    """A function that modifies its argument changes no result; a plate between grid points is found.

    The plate is thinner than the grid of the chords, which search for it between the grid's own points.
    """
    found = estimated("careless", (-0.5, -0.5, -0.5, 0.5, 0.5, 0.5))
    assert 0.0 < found.mass_error < 1e-3 * found.properties.mass
    assert worst_deviation(found, primitive("box", [0.6, 0.6, 0.006], 7.0)) < 4.0


@pytest.mark.slow
def test_level_set_may_return_integers() -> None:
    """A ball of radius 0.35 may be given by the values 0 and 1."""
    found = estimated("counted", (-0.5, -0.5, -0.5, 0.5, 0.5, 0.5))
    assert worst_deviation(found, primitive("sphere", [0.35], 7.0)) < 4.0


@pytest.mark.slow
def test_solid_cut_by_the_box_has_a_note() -> None:
    """A slab wider than the box has a note that names the four sides."""
    found = estimated("slab", (-1.0, -2.0, -1.0, 1.0, 2.0, 1.0)).properties
    sides = "x = -1.0, x = 1.0, y = -2.0, y = 2.0"
    assert found.notes == (f"the solid reaches the sides {sides} of the box and is cut off there",)
    assert found.mass == pytest.approx(2.0 * 4.0 * 0.5 * 7.0, rel=1e-12, abs=0.0)


@pytest.mark.parametrize(("shape", "size"), [("torus", TORUS), ("ellipsoid", (1.0, 0.7, 0.4))])
def test_estimate_of_a_shape_is_near_its_closed_form(shape: str, size: tuple[float, ...]) -> None:
    """The estimate differs from the closed form by its own standard errors."""
    exact = mass_properties(SolidRequest(shape, 1000.0, size))
    found = mass_properties(SolidRequest(shape, 1000.0, size, monte_carlo=True))
    assert isinstance(exact, MassProperties)
    assert isinstance(found, Estimate)
    assert found.properties.mass != exact.mass
    assert worst_deviation(found, exact) < 4.0


@pytest.mark.parametrize("shape", PRIMITIVES)
def test_printed_body_can_be_used_in_a_scenario(shape: str) -> None:
    """The printed [body] gives the same body bit for bit if it is used in a scenario."""
    solid = mass_properties(SolidRequest(shape, 1000.0, [0.7, 0.3, 0.5][: len(PRIMITIVES[shape].sizes)]))
    assert isinstance(solid, MassProperties)
    body, _, _ = "\n".join(as_toml(solid)).partition("[solid]")
    pasted = parse_scenario(f'name = "x"\nduration_s = 1.0\nsamples = 11\n{body}', "x.toml").scene.body
    assert pasted.mass == solid.mass
    assert np.array_equal(pasted.inertia, solid.inertia)


@pytest.mark.slow
def test_printed_estimate_has_an_error_for_each_number() -> None:
    """Mass, centre and inertia are printed at full precision with their standard errors."""
    found = estimated("ring")
    data = tomllib.loads("\n".join(as_toml(found)))
    assert data["body"]["mass_kg"] == found.properties.mass
    assert data["solid"]["mass_standard_error_kg"] == found.mass_error
    assert data["solid"]["centre_standard_error_m"] == found.centre_error.tolist()
    assert data["solid"]["inertia_standard_error_kg_m2"] == found.inertia_error.tolist()
    assert set(data["body"]) == {"mass_kg", "inertia_kg_m2"}


def users(function: str, **how: object) -> SolidRequest:
    """Return a request for a function of the user's module."""
    options = {"density": 1.0, "box": AROUND, "allow_code": True, **how}
    return SolidRequest(f"users_shapes:{function}", **options)  # type: ignore[arg-type]


WRONG = {
    "nothing known": SolidRequest("cone", 1.0),
    "shape without sizes": SolidRequest("torus", 1.0),
    "shape in a box": SolidRequest("torus", 1.0, TORUS, AROUND),
    "shape of wrong sizes": SolidRequest("torus", 1.0, [1.0]),
    "shape of no density": SolidRequest("torus", -1.0, TORUS),
    "neither density nor mass": SolidRequest("torus", None, TORUS),
    "density and mass": SolidRequest("torus", 1.0, TORUS, mass=1.0),
    "shape of no mass": SolidRequest("torus", None, TORUS, mass=0.0),
    "function of a mass": users("ring", density=None, mass=1.0),
    "estimate of wrong sizes": SolidRequest("torus", 1.0, [1.0], monte_carlo=True),
    "estimate of a box": SolidRequest("box", 1.0, [1.0, 1.0, 1.0], monte_carlo=True),
    "mesh with sizes": SolidRequest("part.stl", 1.0, [1.0]),
    "mesh in a box": SolidRequest("part.stl", 1.0, box=AROUND),
    "mesh by estimate": SolidRequest("part.stl", 1.0, monte_carlo=True),
    "shape in a unit": SolidRequest("torus", 1.0, TORUS, unit="mm"),
    "overlapping function": users("ring", overlap="count-twice"),
    "no such mesh": SolidRequest("part.stl", 1.0),
    "code not allowed": users("ring", allow_code=False),
    "function without a box": users("ring", box=None),
    "function with sizes": users("ring", size=[1.0]),
    "function by estimate": users("ring", monte_carlo=True),
    "box of five": users("ring", box=AROUND[:5]),
    "box inside out": users("ring", box=AROUND[3:] + AROUND[:3]),
    "box of nan": users("ring", box=(np.nan, *AROUND[1:])),
    "function of no density": users("ring", density=0.0),
    "no name of a function": SolidRequest("users shapes:f", 1.0, box=AROUND),
    "two colons": SolidRequest("users_shapes::ring", 1.0, box=AROUND),
    "no such module": SolidRequest("no_shapes:f", 1.0, box=AROUND, allow_code=True),
    "module that raises": SolidRequest("broken_shapes:f", 1.0, box=AROUND, allow_code=True),
    "module that leaves": SolidRequest("leaving_shapes:f", 1.0, box=AROUND, allow_code=True),
    "no such function": users("nought"),
    "what cannot be called": users("number"),
    "function that raises": users("raising"),
    "function that leaves": users("leaving"),
    "mask for a level set": users("mask"),
    "words": users("words"),
    "complex numbers": users("waves"),
    "None": users("nothing"),
    "one number": users("one"),
    "no number": users("gap"),
    "empty box": users("outside"),
}


@pytest.mark.slow
@pytest.mark.nightly(after=8)
@pytest.mark.parametrize("what", WRONG)
def test_wrong_solid_is_refused_in_one_line(what: str, expected_message: ExpectedMessage) -> None:
    """An error in a name, option, module or function is one line that begins with it."""
    with pytest.raises(InputError) as caught:
        mass_properties(WRONG[what])
    expected_message(str(caught.value))


def test_code_is_not_run_without_permission(folder: Path) -> None:
    """Without permission the module is not imported."""
    (folder / "deed_shapes.py").write_text("open('deed', 'w')\n")
    with pytest.raises(InputError, match="--allow-code"):
        mass_properties(SolidRequest("deed_shapes:f", 1.0, box=AROUND))
    assert not (folder / "deed").exists()
