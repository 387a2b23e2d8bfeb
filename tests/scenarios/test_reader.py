"""The scenario format: every key, every refusal, all errors of a file at once."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from bodycheck.errors import InputError
from bodycheck.scenarios.library import load_scenario, load_scenarios, scenario_names, suites
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import parse_scenario, read_scenario

GOOD = """
name = "good"
duration_s = 2.0
samples = 21

[body]
mass_kg = 2.0
inertia_kg_m2 = [1.0, 2.0, 2.5]
"""


def parsed(addition: str = "", base: str = GOOD) -> Scenario:
    """Return the scenario that this text holds."""
    return parse_scenario(base + addition, "file.toml")


def refusals(text: str) -> list[str]:
    """Return the lines by which this text is refused."""
    with pytest.raises(InputError) as caught:
        parse_scenario(text, "file.toml")
    return str(caught.value).splitlines()


def test_a_minimal_file_starts_at_rest_at_the_origin() -> None:
    """Every key of [initial] is optional; the body is at rest at the origin, axes aligned."""
    start = parsed().scene.initial
    assert start.quaternion.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert not np.any([start.position, start.velocity, start.omega_body])


def test_times_are_computed_from_the_sample_number() -> None:
    """Sample k lies at k T / (n - 1)."""
    times = parsed().scene.sample_times
    assert times.tolist() == [k * 2.0 / 20 for k in range(21)]


def test_omega_in_world_axes_is_turned_into_body_axes() -> None:
    """omega_world_rad_s is R omega_body."""
    half = math.sqrt(0.5)
    scene = parsed(
        f"[initial]\nquaternion = [{half!r}, 0, 0, {half!r}]\nomega_world_rad_s = [1, 2, 3]\n"
    ).scene
    assert scene.initial.omega_body == pytest.approx([2.0, -1.0, 3.0], abs=1e-15)


def test_a_quaternion_near_unit_is_normalised() -> None:
    """A quaternion within 1e-6 of unit is accepted and made unit."""
    scene = parsed("[initial]\nquaternion = [1.0000005, 0, 0, 0]\n").scene
    assert scene.initial.quaternion.tolist() == [1.0, 0.0, 0.0, 0.0]


def test_a_full_tensor_is_taken_as_it_stands() -> None:
    """The off-diagonals are the tensor's own, I_xy = -sum m x y."""
    rows = "[[0.9, 0.04, -0.03], [0.04, 1.1, 0.02], [-0.03, 0.02, 1.3]]"
    scene = parsed(base=GOOD.replace("[1.0, 2.0, 2.5]", rows)).scene
    assert scene.body.inertia[0].tolist() == [0.9, 0.04, -0.03]


def test_forcings_become_loads_and_gravity() -> None:
    """A torque and a force keep their times; accelerations of gravity add up."""
    scene = parsed(
        '[[forcing]]\nkind = "torque"\naxes = "world"\nvalue_n_m = [1, 2, 3]\nfrom_s = 0.5\nuntil_s = 1\n'
        '[[forcing]]\nkind = "force"\naxes = "body"\nvalue_n = [1, 0, 0]\nat_m = [0, 1, 0]\n'
        '[[forcing]]\nkind = "gravity"\nacceleration_m_s2 = [0, 0, -9]\n'
        '[[forcing]]\nkind = "gravity"\nacceleration_m_s2 = [0, 1, -1]\n'
    ).scene
    assert [(load.from_s, load.until_s) for load in scene.loads] == [(0.5, 1.0), (0.0, math.inf)]
    assert scene.gravity.tolist() == [0.0, 1.0, -10.0]
    assert scene.switches_before(2.0) == (0.5, 1.0)


BODY = 'name = "x"\nduration_s = 1\nsamples = 11\n[body]\n'
FAULTS = {
    "unknown key": (
        GOOD.replace("mass_kg", "mas_kg"),
        ["body.mass_kg: is required", "body.mas_kg: is no key"],
    ),
    "unknown table": (GOOD + "[other]\n", ["other: is no key"]),
    "text for a number": (GOOD.replace("2.0\nsam", '"2"\nsam'), ["duration_s: should be a valid number"]),
    "truth for a number": (GOOD.replace("mass_kg = 2.0", "mass_kg = true"), ["body.mass_kg: should be"]),
    "number for text": (GOOD.replace('"good"', "3"), ["name: should be a valid string"]),
    "empty name": (GOOD.replace('"good"', '""'), ["name: "]),
    "name of two lines": (GOOD.replace('"good"', r'"a\nb"'), ["name: must be one line"]),
    "no duration": (GOOD.replace("duration_s = 2.0", ""), ["duration_s: is required"]),
    "negative duration": (GOOD.replace("2.0\nsam", "-2.0\nsam"), ["duration_s: should be greater than 0"]),
    "infinite duration": (GOOD.replace("2.0\nsam", "inf\nsam"), ["duration_s: should be a finite number"]),
    "huge whole number": (GOOD.replace("2.0\nsam", "1" + 400 * "0" + "\nsam"), ["duration_s: should be"]),
    "one sample": (GOOD.replace("21", "1"), ["samples: should be greater than or equal to 2"]),
    "half a sample": (GOOD.replace("21", "21.5"), ["samples: should be a valid integer"]),
    "too many samples": (GOOD.replace("21", "10000000"), ["samples: should be less than"]),
    "NaN mass": (GOOD.replace("mass_kg = 2.0", "mass_kg = nan"), ["body.mass_kg: should be a finite number"]),
    "zero mass": (GOOD.replace("mass_kg = 2.0", "mass_kg = 0"), ["body.mass_kg: should be greater than 0"]),
    "NaN inertia": (GOOD.replace("[1.0, 2.0", "[nan, 2.0"), ["inertia_kg_m2: needs finite numbers"]),
    "negative inertia": (GOOD.replace("[1.0, 2.0", "[-1.0, 2.0"), ["must be positive definite"]),
    "impossible body": (GOOD.replace("2.5]", "5.0]"), ["triangle inequality"]),
    "DETEST B5's body": (BODY + "mass_kg = 1\ninertia_kg_m2 = [1, 1, 0]\n", ["must be positive definite"]),
    "two moments": (GOOD.replace("[1.0, 2.0, 2.5]", "[1.0, 2.0]"), ["needs three principal moments"]),
    "ragged tensor": (
        GOOD.replace("[1.0, 2.0, 2.5]", "[[1, 0], [0, 1, 0], [0]]"),
        ["a 3x3 tensor of numbers"],
    ),
    "text in a tensor": (GOOD.replace("[1.0, 2.0", '["1", 2.0'), ["inertia_kg_m2: needs three"]),
    "unsymmetric tensor": (
        GOOD.replace("[1.0, 2.0, 2.5]", "[[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]"),
        ["must be symmetric"],
    ),
    "published heavy top": (BODY + "mass_kg = 20\ninertia_kg_m2 = [-15, -15, 1]\n", ["positive definite"]),
    "link frame": (GOOD + "link_offset_m = [0, 0, 1]\n", ["link_offset_m is not yet supported"]),
    "sweep": (GOOD + "[[sweep]]\nkey = 'a'\nvalues = [1]\n", ["sweep: sweep is not yet supported"]),
    "long quaternion": (GOOD + "[initial]\nquaternion = [1, 1, 0, 0]\n", ["its norm is 1.41421356"]),
    "zero quaternion": (GOOD + "[initial]\nquaternion = [0, 0, 0, 0]\n", ["must be a unit quaternion"]),
    "three numbers of four": (GOOD + "[initial]\nquaternion = [1, 0, 0]\n", ["initial.quaternion[3]"]),
    "two omegas": (
        GOOD + "[initial]\nomega_body_rad_s = [1, 2, 3]\nomega_world_rad_s = [1, 2, 3]\n",
        ["initial.omega_world_rad_s: give omega_body_rad_s or omega_world_rad_s, not both"],
    ),
    "four components": (GOOD + "[initial]\nvelocity_m_s = [1, 2, 3, 4]\n", ["needs 3 numbers, not 4"]),
    "forcing without a kind": (GOOD + '[[forcing]]\naxes = "body"\n', ["forcing[0]: needs a kind"]),
    "unknown kind": (GOOD + '[[forcing]]\nkind = "magic"\n', ["no forcing is of kind 'magic'"]),
    "forcing is no table": (GOOD.replace("[body]", "forcing = [3]\n[body]"), ["forcing[0]: needs a kind"]),
    "unknown axes": (
        GOOD + '[[forcing]]\nkind = "torque"\naxes = "link"\nvalue_n_m = [1, 0, 0]\n',
        ["forcing[0].axes: should be 'body' or 'world'"],
    ),
    "ends before it begins": (
        GOOD
        + '[[forcing]]\nkind = "torque"\naxes = "body"\nvalue_n_m = [1, 0, 0]\nfrom_s = 2\nuntil_s = 1\n',
        ["forcing[0].until_s: must be later than from_s = 2.0"],
    ),
    "step that does not divide": (
        GOOD.replace("samples = 21", "samples = 21\nsteps_s = [0.1, 0.03]"),
        ["steps_s: a step of 0.03 s does not divide the sampling interval of 0.1 s; the nearest"],
    ),
    "negative step": (
        GOOD.replace("samples = 21", "samples = 21\nsteps_s = [-0.1]"),
        ["steps_s[0]: should be greater than 0"],
    ),
    "a step twice": (
        GOOD.replace("samples = 21", "samples = 21\nsteps_s = [0.1, 0.05, 0.1]"),
        ["steps_s: names a step twice"],
    ),
    "nested too deeply": ("a = " + "[" * 3000 + "]" * 3000, ["is nested too deeply"]),
    "no steps": (GOOD.replace("samples = 21", "samples = 21\nsteps_s = []"), ["needs at least one step"]),
    "not TOML": ("name = ", ["file.toml: is not TOML"]),
    **{
        f"later kind {kind}": (GOOD + f'[[forcing]]\nkind = "{kind}"\n', [f"{kind!r} is not yet supported"])
        for kind in (
            *("sine-torque", "drag", "spring", "torsion-spring"),
            *("pivot", "gravity-gradient", "callable"),
        )
    },
}


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_refused_by_a_line_that_names_it(fault: str) -> None:
    """Each wrong file is refused, and a line says where and what would be right."""
    text, expected = FAULTS[fault]
    lines = refusals(text)
    for part in expected:
        assert any(part in line for line in lines), lines
    assert all(line.startswith("file.toml: ") for line in lines)


def test_all_errors_of_a_file_come_at_once() -> None:
    """One reading reports every error, also those that look at two keys, one line each."""
    lines = refusals(
        """
name = "x"
duration_s = 1.0
samples = 11
steps_s = [0.03]
foo = 1
[body]
mass_kg = -1
inertia_kg_m2 = [1, 2, 5]
[initial]
omega_body_rad_s = [1, 2, 3]
omega_world_rad_s = [1, 2, 3]
[[forcing]]
kind = "drag"
[[forcing]]
kind = "torque"
axes = "body"
value_n_m = [1, nan, 3]
from_s = 2
until_s = 1
"""
    )
    paths = [line.split(": ")[1] for line in lines]
    assert sorted(paths) == sorted(
        [
            *("steps_s", "foo", "body.mass_kg", "body.inertia_kg_m2", "initial.omega_world_rad_s"),
            *("forcing[0]", "forcing[1].value_n_m[1]", "forcing[1].until_s"),
        ]
    )


def test_a_plate_on_the_limit_is_accepted() -> None:
    """I1 + I2 = I3 is a flat plate, a possible body; so is a breach below 1e-12."""
    for third in ("3.0", "3.0000000000001"):
        parsed(base=GOOD.replace("2.5]", f"{third}]"))


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    """A missing file, a folder and binary data each end in one line that names the file."""
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    for path, why in ((tmp_path / "no.toml", "No such file"), (tmp_path, "directory"), (binary, "UTF-8")):
        with pytest.raises(InputError, match=why) as caught:
            read_scenario(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


LIBRARY = (
    *("sphere", "symmetric-top", "intermediate-axis", "tumbling", "full-tensor", "near-separatrix"),
    *("body-torque", "world-torque", "thruster", "boxes", "free-body", "pulsed-torque"),
    *("t-handle", "torus-spin-up"),
)


def test_the_library_is_listed() -> None:
    """The list by which the library is tested leaves none of it out."""
    assert sorted(LIBRARY) == list(scenario_names())


@pytest.mark.parametrize("name", LIBRARY)
def test_the_library_has_each_scenario_with_its_source(name: str) -> None:
    """A built-in scenario is found by name, says where it is from, and its tags fit its loads."""
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.summary
    assert scenario.source
    assert ("torque-free" in scenario.tags) == scenario.scene.is_free_rotation
    assert ("forced" in scenario.tags) == (not scenario.scene.is_free_rotation)
    assert len(scenario.steps) >= 4


def test_suites_name_built_in_scenarios_only() -> None:
    """Every member of every suite exists; standard is the whole library."""
    for members in suites().values():
        assert set(members) <= set(scenario_names())
    assert suites()["standard"] == scenario_names()


def test_names_suites_and_paths_may_be_mixed(tmp_path: Path) -> None:
    """A scenario asked for twice comes once, and each knows how it was asked for."""
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    asked = ["sphere", str(path), "smoke", "sphere"]
    assert [how for how, _ in load_scenarios(asked)] == ["sphere", str(path), *suites()["smoke"]]


def test_two_different_scenarios_of_one_name_are_refused(tmp_path: Path) -> None:
    """Rows of two scenarios must not be mixed up under one name."""
    path = tmp_path / "mine.toml"
    path.write_text(GOOD.replace("good", "sphere"))
    with pytest.raises(InputError, match="another scenario of this run is named 'sphere'"):
        load_scenarios(["sphere", str(path)])


@pytest.mark.parametrize(("name", "part"), [("nope", "neither"), ("hard", "not yet"), ("full", "not yet")])
def test_unknown_names_say_what_there_is(name: str, part: str) -> None:
    """A name that is nothing lists the names that are something."""
    with pytest.raises(InputError, match=part):
        load_scenarios([name])
