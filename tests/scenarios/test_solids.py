"""Solids as the command line names them: meshes, shapes, and level sets that a user wrote."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scenario_text import parse_scenario

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.mass_properties.solid import PRIMITIVES, MassProperties
from bodycheck.scenarios.level_sets import Estimate
from bodycheck.scenarios.shapes import primitive
from bodycheck.scenarios.solids import SolidRequest, as_toml, mass_properties

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
    """Work in a folder with a user's modules, and leave nothing of them behind."""
    (tmp_path / "users_shapes.py").write_text(USERS)
    (tmp_path / "broken_shapes.py").write_text("1 / 0\n")
    (tmp_path / "leaving_shapes.py").write_text("raise SystemExit(3)\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield tmp_path
    for name in ("users_shapes", "broken_shapes", "leaving_shapes"):
        sys.modules.pop(name, None)


def estimated(name: str, box: tuple[float, ...] = AROUND) -> Estimate:
    """Return the estimate of a function of the user's module at 7 kg/m^3."""
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


def test_a_users_level_set_is_estimated_with_its_standard_errors() -> None:
    """A torus about y at 7 kg/m^3 is within 4 standard errors, each below 1e-3 of the whole."""
    truth = primitive("torus", TORUS, 7.0).rotated(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]))
    found = estimated("ring")
    assert worst_deviation(found, truth) < 4.0
    assert 0.0 < found.mass_error < 1e-3 * truth.mass
    assert np.max(found.inertia_error) < 1e-3 * np.max(truth.inertia)
    assert found.properties.notes == ()


def test_a_function_may_change_its_points() -> None:
    """A function that works in place spoils nothing.

    Its plate is thinner than the grid of the chords, which look for it between the grid's own points.
    """
    found = estimated("careless", (-0.5, -0.5, -0.5, 0.5, 0.5, 0.5))
    assert 0.0 < found.mass_error < 1e-3 * found.properties.mass
    assert worst_deviation(found, primitive("box", [0.6, 0.6, 0.006], 7.0)) < 4.0


def test_whole_numbers_will_do() -> None:
    """f may give whole numbers: a ball of radius 0.35 by 0 and 1."""
    found = estimated("counted", (-0.5, -0.5, -0.5, 0.5, 0.5, 0.5))
    assert worst_deviation(found, primitive("sphere", [0.35], 7.0)) < 4.0


def test_a_solid_that_the_box_cuts_is_noted() -> None:
    """A slab without end fills the box's breadth: the four sides that it reaches are named."""
    found = estimated("slab", (-1.0, -2.0, -1.0, 1.0, 2.0, 1.0)).properties
    sides = "x = -1.0, x = 1.0, y = -2.0, y = 2.0"
    assert found.notes == (f"the solid reaches the sides {sides} of the box and is cut off there",)
    assert found.mass == pytest.approx(2.0 * 4.0 * 0.5 * 7.0, rel=1e-12, abs=0.0)


@pytest.mark.parametrize(("shape", "size"), [("torus", TORUS), ("ellipsoid", (1.0, 0.7, 0.4))])
def test_monte_carlo_shows_its_error_against_the_closed_form(shape: str, size: tuple[float, ...]) -> None:
    """The estimate of a shape is near its closed form by its own standard errors, but not equal to it."""
    exact = mass_properties(SolidRequest(shape, 1000.0, size))
    found = mass_properties(SolidRequest(shape, 1000.0, size, monte_carlo=True))
    assert isinstance(exact, MassProperties)
    assert isinstance(found, Estimate)
    assert found.properties.mass != exact.mass
    assert worst_deviation(found, exact) < 4.0


@pytest.mark.parametrize("shape", PRIMITIVES)
def test_what_is_printed_goes_into_a_scenario(shape: str) -> None:
    """The printed [body], set into a scenario, is the very same body, to the last bit."""
    solid = mass_properties(SolidRequest(shape, 1000.0, [0.7, 0.3, 0.5][: len(PRIMITIVES[shape].sizes)]))
    assert isinstance(solid, MassProperties)
    body, _, _ = "\n".join(as_toml(solid)).partition("[solid]")
    pasted = parse_scenario(f'name = "x"\nduration_s = 1.0\nsamples = 11\n{body}', "x.toml").scene.body
    assert pasted.mass == solid.mass
    assert np.array_equal(pasted.inertia, solid.inertia)


def test_what_is_printed_of_an_estimate_has_an_error_for_each_number() -> None:
    """Mass, centre and inertia each stand with their standard errors, at full precision."""
    found = estimated("ring")
    told = tomllib.loads("\n".join(as_toml(found)))
    assert told["body"]["mass_kg"] == found.properties.mass
    assert told["solid"]["mass_standard_error_kg"] == found.mass_error
    assert told["solid"]["centre_standard_error_m"] == found.centre_error.tolist()
    assert told["solid"]["inertia_standard_error_kg_m2"] == found.inertia_error.tolist()
    assert set(told["body"]) == {"mass_kg", "inertia_kg_m2"}


def users(function: str, **how: object) -> SolidRequest:
    """Ask for a function of the user's module."""
    options = {"density": 1.0, "box": AROUND, "allow_code": True, **how}
    return SolidRequest(f"users_shapes:{function}", **options)  # type: ignore[arg-type]


WRONG = {
    "nothing known": (
        SolidRequest("cone", 1.0),
        "cone: is neither a mesh file (.stl, .obj, .ply), nor a shape (box, ",
    ),
    "shape without sizes": (SolidRequest("torus", 1.0), "torus: a shape requires --size-m"),
    "shape in a box": (SolidRequest("torus", 1.0, TORUS, AROUND), "torus: a shape does not take --box-m"),
    "shape of wrong sizes": (
        SolidRequest("torus", 1.0, [1.0]),
        "a torus has 2 sizes (major radius, minor radius), not 1",
    ),
    "shape of no density": (
        SolidRequest("torus", -1.0, TORUS),
        "density must be positive and finite, not -1.0",
    ),
    "estimate of wrong sizes": (SolidRequest("torus", 1.0, [1.0], monte_carlo=True), "a torus has 2 sizes"),
    "estimate of a box": (
        SolidRequest("box", 1.0, [1.0, 1.0, 1.0], monte_carlo=True),
        "box: --monte-carlo is only for ellipsoid, torus",
    ),
    "mesh with sizes": (SolidRequest("part.stl", 1.0, [1.0]), "part.stl: a mesh file does not take --size-m"),
    "mesh in a box": (
        SolidRequest("part.stl", 1.0, box=AROUND),
        "part.stl: a mesh file does not take --box-m",
    ),
    "mesh by estimate": (
        SolidRequest("part.stl", 1.0, monte_carlo=True),
        "part.stl: --monte-carlo is only for ellipsoid",
    ),
    "shape in a unit": (
        SolidRequest("torus", 1.0, TORUS, unit="mm"),
        "torus: --unit is for mesh files, not for a sh",
    ),
    "overlapping function": (
        users("ring", overlap="count-twice"),
        "users_shapes:ring: --overlap is for mesh files, not for a function",
    ),
    "no such mesh": (SolidRequest("part.stl", 1.0), "part.stl: cannot be read: No such file"),
    "code not allowed": (
        users("ring", allow_code=False),
        "users_shapes:ring: importing it runs its code; add --allow-code if you trust it",
    ),
    "function without a box": (users("ring", box=None), "users_shapes:ring: a function requires --box-m"),
    "function with sizes": (
        users("ring", size=[1.0]),
        "users_shapes:ring: a function does not take --size-m",
    ),
    "function by estimate": (
        users("ring", monte_carlo=True),
        "users_shapes:ring: --monte-carlo is only for ",
    ),
    "box of five": (
        users("ring", box=AROUND[:5]),
        "users_shapes:ring: the box needs 6 numbers, xmin,ymin,zmin,",
    ),
    "box inside out": (
        users("ring", box=AROUND[3:] + AROUND[:3]),
        "users_shapes:ring: the box from [1.4, 0.4",
    ),
    "box of nan": (users("ring", box=(np.nan, *AROUND[1:])), "users_shapes:ring: the box from [nan, -0.4"),
    "function of no density": (users("ring", density=0.0), "users_shapes:ring: density must be positive"),
    "no name of a function": (
        SolidRequest("users shapes:f", 1.0, box=AROUND),
        "users shapes:f: not the name of a function",
    ),
    "two colons": (
        SolidRequest("users_shapes::ring", 1.0, box=AROUND),
        "users_shapes::ring: not the name of a function",
    ),
    "no such module": (
        SolidRequest("no_shapes:f", 1.0, box=AROUND, allow_code=True),
        "no_shapes:f: cannot be imported: ModuleNotFoundError: No module named 'no_shapes'",
    ),
    "module that raises": (
        SolidRequest("broken_shapes:f", 1.0, box=AROUND, allow_code=True),
        "broken_shapes:f: cannot be imported: ZeroDivisionError: division by zero",
    ),
    "module that leaves": (
        SolidRequest("leaving_shapes:f", 1.0, box=AROUND, allow_code=True),
        "leaving_shapes:f: cannot be imported: SystemExit: 3",
    ),
    "no such function": (users("nought"), "users_shapes:nought: users_shapes has no function 'nought'"),
    "what cannot be called": (users("number"), "users_shapes:number: users_shapes has no function 'number'"),
    "function that raises": (
        users("raising"),
        "users_shapes:raising: failed for points (266240, 3): ZeroDivis",
    ),
    "function that leaves": (
        users("leaving"),
        "users_shapes:leaving: failed for points (266240, 3): SystemEx",
    ),
    "mask for a level set": (
        users("mask"),
        "users_shapes:mask: f(points) for points (266240, 3) must return numbers",
    ),
    "words": (
        users("words"),
        "users_shapes:words: f(points) for points (266240, 3) must return numbers, not <U3",
    ),
    "complex numbers": (
        users("waves"),
        "users_shapes:waves: f(points) for points (266240, 3) must return numbers",
    ),
    "None": (
        users("nothing"),
        "users_shapes:nothing: f(points) for points (266240, 3) must return numbers, not ob",
    ),
    "one number": (users("one"), "users_shapes:one: f of points (266240, 3) must be (266240,), not ()"),
    "no number": (users("gap"), "users_shapes:gap: f is not a number at ["),
    "empty box": (users("outside"), "users_shapes:outside: no part of the solid was found in the box from"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_with_a_solid_is_said_in_one_line(what: str) -> None:
    """Whatever a name, an option, a module or its function has wrong is one line that begins with it."""
    asked, message = WRONG[what]
    with pytest.raises(InputError) as caught:
        mass_properties(asked)
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_code_that_is_not_allowed_is_not_run(folder: Path) -> None:
    """Without permission the module is not imported: what it does on import does not happen."""
    (folder / "deed_shapes.py").write_text("open('deed', 'w')\n")
    with pytest.raises(InputError, match="--allow-code"):
        mass_properties(SolidRequest("deed_shapes:f", 1.0, box=AROUND))
    assert not (folder / "deed").exists()
