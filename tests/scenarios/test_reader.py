"""The scenario format: every key, every refusal, all errors of a file at once."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scenario_text import HERE, parse_scenario

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.scene import (
    CallbackLoad,
    Drag,
    GravityGradient,
    SineTorque,
    Spring,
    TorsionSpring,
)
from bodycheck.scenarios.library import PROBES, load_scenario, load_scenarios, scenario_names, suites
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import parse_members

GOOD = """
name = "good"
duration_s = 2.0
samples = 21

[body]
mass_kg = 2.0
inertia_kg_m2 = [1.0, 2.0, 2.5]
"""

SWEPT = (
    GOOD
    + """
[initial]
omega_body_rad_s = [0.1, 2.0, 0.1]
[[sweep]]
key = "initial.omega_body_rad_s[0]"
values = [1e-3, 1e-12]
"""
)


def parsed(addition: str = "", base: str = GOOD) -> Scenario:
    """Return the scenario that this text holds."""
    return parse_scenario(base + addition, "file.toml")


def refusals(text: str) -> list[str]:
    """Return the lines by which this text is refused."""
    with pytest.raises(InputError) as caught:
        parse_members(text, "file.toml", HERE)
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


def test_engines_are_handed_a_unit_quaternion_and_the_truth_the_one_of_the_file() -> None:
    """A quaternion within 1e-6 of unit is accepted: made unit for engines, as it is written for the truth."""
    scenario = parsed("[initial]\nquaternion = [1.0000005, 0, 0, 0]\n")
    assert scenario.scene.initial.quaternion.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert scenario.scene_as_written.initial.quaternion.tolist() == [1.0000005, 0.0, 0.0, 0.0]
    assert scenario.initial.quaternion == (1.0000005, 0.0, 0.0, 0.0)


def test_a_unit_quaternion_of_doubles_is_handed_on_as_it_is() -> None:
    """A norm that is off by two ulps is no reason to change the digits of the file."""
    written = [0.5, 0.5, 0.5, 0.500000000000001]
    assert math.hypot(*written) > 1.0
    scenario = parsed(f"[initial]\nquaternion = {written}\n")
    assert scenario.scene.initial.quaternion.tolist() == written


def test_the_truth_begins_from_omega_as_it_is_written() -> None:
    """Engines get omega in body axes, rounded; the start as written keeps that of the world."""
    scenario = parsed("[initial]\nquaternion = [0.6, 0.8, 0, 0]\nomega_world_rad_s = [1, 2, 3]\n")
    assert scenario.scene.initial.exact_omega_world is None
    exact = scenario.scene_as_written.initial.exact_omega_world
    assert exact is not None
    assert exact.tolist() == [1.0, 2.0, 3.0]
    assert np.array_equal(scenario.scene_as_written.initial.omega_body, scenario.scene.initial.omega_body)


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
        ["body.mass_kg: is required", "body.mas_kg: is not a key"],
    ),
    "unknown table": (GOOD + "[other]\n", ["other: is not a key"]),
    "text for a number": (GOOD.replace("2.0\nsam", '"2"\nsam'), ["duration_s: should be a valid number"]),
    "truth for a number": (GOOD.replace("mass_kg = 2.0", "mass_kg = true"), ["body.mass_kg: should be"]),
    "number for text": (GOOD.replace('"good"', "3"), ["name: should be a valid string"]),
    "empty name": (GOOD.replace('"good"', '""'), ["name: "]),
    "name of two lines": (GOOD.replace('"good"', r'"a\nb"'), ["name: must be one line"]),
    "name with a slash": (GOOD.replace('"good"', '"a/b"'), ["name: must have no slash"]),
    "family's name with a slash": (SWEPT.replace('"good"', '"a/b"'), ["file.toml: name: must have no slash"]),
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
    "two numbers of a link": (GOOD + "link_offset_m = [0, 1]\n", ["body.link_offset_m[2]: is required"]),
    "long link quaternion": (
        GOOD + "link_quaternion = [0, 0, 0, 2]\n",
        ["body.link_quaternion: must be a unit"],
    ),
    **{
        f"sweep, {what}": (GOOD + f"[[sweep]]\n{text}\n", [f"sweep{expected}"])
        for what, text, expected in (
            ("no key", "values = [1]", "[0].key: is required"),
            ("no values", "key = 'duration_s'", "[0].values: is required"),
            ("empty values", "key = 'duration_s'\nvalues = []", "[0].values: "),
            ("NaN", "key = 'duration_s'\nvalues = [nan]", "[0].values[0]"),
            ("a value twice", "key = 'duration_s'\nvalues = [1, 1.0]", "[0].values: names a value twice"),
            ("a name", "key = 'name'\nvalues = ['a']", "[0].key: cannot be 'name'"),
            ("no path", "key = 'a..b'\nvalues = [1]", "[0].key: must be a path in the file"),
            (
                "nowhere",
                "key = 'forcing[0].at_m[0]'\nvalues = [1]",
                "[0].key: 'forcing[0].at_m[0]' is not a path",
            ),
            (
                "beyond a list",
                "key = 'body.inertia_kg_m2[3]'\nvalues = [1]",
                "[0].key: 'body.inertia_kg_m2[3]'",
            ),
            ("into a number", "key = 'duration_s.x'\nvalues = [1]", "[0].key: 'duration_s.x' is not a path"),
            ("twice", "key = 'samples'\nvalues = [3]\n[[sweep]]\nkey = 'samples'\nvalues = [4]", ": "),
            ("no list", "key = 3\nvalues = 3", "[0].values: should be"),
        )
    },
    "sweep that is a number": ("sweep = 3\n" + GOOD, ["sweep: should be"]),
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
        f"{kind} without {key}": (
            GOOD + f'[[forcing]]\nkind = "{kind}"\n',
            [f"forcing[0].{key}: is required"],
        )
        for kind, keys in {
            "sine-torque": ("axes", "amplitude_n_m", "rate_rad_s"),
            "spring": ("anchor_m", "stiffness_n_m"),
            "torsion-spring": ("stiffness_n_m",),
            "pivot": ("at_m",),
            "gravity-gradient": ("orbit_rate_rad_s",),
            "callable": ("function",),
        }.items()
        for key in keys
    },
    **{
        f"{kind} with {key} = {value}": (
            GOOD + f'[[forcing]]\nkind = "{kind}"\n{key} = {value}\n',
            [f"forcing[0].{key}{where}"],
        )
        for kind, key, value, where in (
            ("drag", "linear_n_s_m", "-1", ": should be greater than or equal to 0"),
            ("drag", "linear_n_s_m", "nan", ": should be a finite number"),
            ("drag", "angular_n_m_s", "-0.1", ": must take energy away"),
            ("drag", "angular_n_m_s", "[[1, 3, 0], [3, 1, 0], [0, 0, 1]]", ": must take energy away"),
            ("drag", "angular_n_m_s", "[1, 2, 3]", ": needs a number or a 3x3 matrix"),
            ("drag", "angular_n_m_s", "[[1, 0], [0]]", ": needs a number or a 3x3 matrix"),
            ("drag", "angular_n_m_s", "true", ": needs a number or a 3x3 matrix"),
            ("drag", "angular_n_m_s", "inf", ": needs finite numbers"),
            ("spring", "stiffness_n_m", "0", ": should be greater than 0"),
            ("spring", "rest_length_m", "-1", ": should be greater than or equal to 0"),
            ("spring", "anchor_m", "[0, 0]", "[2]: is required"),
            ("torsion-spring", "stiffness_n_m", "-1", ": should be greater than 0"),
            ("gravity-gradient", "orbit_rate_rad_s", "0", ": should be greater than 0"),
            ("sine-torque", "rate_rad_s", "nan", ": should be a finite number"),
            ("sine-torque", "axes", "'link'", ": should be 'body' or 'world'"),
            ("sine-torque", "until_s", "1", ": is not a key"),
            ("pivot", "at_m", "[0, 0, nan]", "[2]: should be a finite number"),
            ("callable", "function", "3", ": needs the name of a function"),
            ("callable", "function", "'wrench'", ": wrench: not the name of a function"),
            (
                "callable",
                "function",
                "'os:getcwd'",
                ": os:getcwd: importing it runs its code; add --allow-code",
            ),
        )
    },
    "two pivots": (
        GOOD + 2 * '[[forcing]]\nkind = "pivot"\nat_m = [0, 0, 1]\n',
        ["forcing: has 2 of kind 'pivot', at [0, 1]; there can be one at most"],
    ),
    "two orbits": (
        GOOD + 2 * '[[forcing]]\nkind = "gravity-gradient"\norbit_rate_rad_s = 1\n',
        ["forcing: has 2 of kind 'gravity-gradient'"],
    ),
    "pivot in orbit": (
        GOOD
        + '[[forcing]]\nkind = "pivot"\nat_m = [0, 0, 1]\n'
        + '[[forcing]]\nkind = "gravity-gradient"\norbit_rate_rad_s = 1\n',
        ["forcing: a body with a pivot is in no orbit"],
    ),
    "velocity that moves the pivot": (
        GOOD
        + "[initial]\nomega_body_rad_s = [1, 0, 0]\nvelocity_m_s = [0, -1, 0]\n"
        + '[[forcing]]\nkind = "pivot"\nat_m = [0, 0, 1]\n',
        ["forcing: the pivot is fixed", "= [0.0, 1.0, 0.0]"],
    ),
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
kind = "magic"
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
            load_scenario(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def pivoted(initial: str) -> Scenario:
    """Return the good scenario about a pivot 0.5 m below its centre of mass."""
    return parsed(f'[initial]\n{initial}\n[[forcing]]\nkind = "pivot"\nat_m = [0, 0, -0.5]\n')


@pytest.mark.parametrize("text", [GOOD, SWEPT], ids=["alone", "family"])
@pytest.mark.parametrize(
    ("value", "why"),
    [
        ("1" * 5000, "file.toml: has an integer with too many digits"),
        ("[" * 5000 + "]" * 5000, "file.toml: is nested too deeply"),
    ],
    ids=["digits", "lists"],
)
def test_numbers_and_lists_without_end_are_refused(value: str, why: str, text: str) -> None:
    """What no reader can hold ends in one line, in a family too."""
    assert refusals(f"foo = {value}\n{text}") == [why]


def test_about_a_pivot_the_centre_moves_as_the_rotation_says() -> None:
    """v = omega x (x - pivot) in world axes, whether the file says it, to nine digits, or not."""
    half = math.sqrt(0.5)
    turned = f"quaternion = [{half!r}, {half!r}, 0, 0]\nomega_body_rad_s = [1, 2, 3]"
    scene = pivoted(turned).scene
    assert scene.pivot is not None
    # R takes z to -y: the centre is 0.5 m along -y from the pivot, and omega is (1, -3, 2)
    expected = np.cross([1.0, -3.0, 2.0], [0.0, -0.5, 0.0])
    assert scene.initial.velocity == pytest.approx(expected, abs=1e-15)
    said = pivoted(turned + f"\nvelocity_m_s = {(expected * (1.0 + 1e-10)).tolist()}").scene
    assert np.array_equal(said.initial.velocity, scene.initial.velocity)


def test_each_kind_becomes_its_load() -> None:
    """Every key of every kind reaches the arrays; an angular drag may be one number; defaults are zero."""
    scene = parsed(
        """
[[forcing]]
kind = "sine-torque"
axes = "world"
amplitude_n_m = [1, 2, 3]
rate_rad_s = 4
phase_rad = 5
[[forcing]]
kind = "drag"
linear_n_s_m = 1
angular_n_m_s = 2
[[forcing]]
kind = "spring"
anchor_m = [1, 2, 3]
at_m = [4, 5, 6]
stiffness_n_m = 7
rest_length_m = 8
[[forcing]]
kind = "torsion-spring"
stiffness_n_m = 9
[[forcing]]
kind = "gravity-gradient"
orbit_rate_rad_s = 10
"""
    ).scene
    sine, drag, spring, torsion, gradient = scene.loads
    assert isinstance(sine, SineTorque)
    assert (sine.axes, sine.amplitude.tolist(), sine.rate, sine.phase) == ("world", [1.0, 2.0, 3.0], 4.0, 5.0)
    assert isinstance(drag, Drag)
    assert drag.linear == 1.0
    assert np.array_equal(drag.angular, 2.0 * np.eye(3))
    assert isinstance(spring, Spring)
    assert (spring.anchor.tolist(), spring.at.tolist()) == ([1.0, 2.0, 3.0], [4.0, 5.0, 6.0])
    assert (spring.stiffness, spring.rest_length) == (7.0, 8.0)
    assert isinstance(torsion, TorsionSpring)
    assert torsion.stiffness == 9.0
    assert isinstance(gradient, GravityGradient)
    assert gradient.rate == 10.0
    (bare,) = parsed('[[forcing]]\nkind = "drag"\n').scene.loads
    assert isinstance(bare, Drag)
    assert not bare.linear
    assert not bare.angular.any()


def test_a_link_frame_reaches_the_scene() -> None:
    """What is not said of it is the centre of mass, and the body axes; nothing said is no link at all."""
    assert parsed().scene.link is None
    link = parsed("link_offset_m = [1, 2, 3]\n").scene.link
    assert link is not None
    assert link.offset.tolist() == [1.0, 2.0, 3.0]
    assert link.quaternion.tolist() == [1.0, 0.0, 0.0, 0.0]
    link = parsed("link_quaternion = [0, 0, 0, 1.0000005]\n").scene.link
    assert link is not None
    assert not link.offset.any()
    assert link.quaternion.tolist() == [0.0, 0.0, 0.0, 1.0]


WRENCH = """
import numpy as np

def wrench(t, position, rotation, velocity, omega):
    position[:] = 7.0
    return [t, 2.0, 3.0], -omega

def torque_only(t, position, rotation, velocity, omega):
    return -omega

def broken(t, position, rotation, velocity, omega):
    return 1 / 0
"""
STILL = (np.zeros(3), np.eye(3), np.zeros(3), np.ones(3))


def called(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> CallbackLoad:
    """Return the load that a function of WRENCH becomes, where code is allowed."""
    (folder / "user_wrench.py").write_text(WRENCH)
    monkeypatch.chdir(folder)
    text = f'[[forcing]]\nkind = "callable"\nfunction = "user_wrench:{name}"\n'
    (load,) = parse_scenario(GOOD + text, "file.toml", allow_code=True).scene.loads
    assert isinstance(load, CallbackLoad)
    return load


def test_a_function_is_imported_where_code_is_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is asked with copies, and gives force and torque as arrays."""
    load = called("wrench", tmp_path, monkeypatch)
    force, torque = load.function(0.25, *STILL)
    assert force.tolist() == [0.25, 2.0, 3.0]
    assert torque.tolist() == [-1.0, -1.0, -1.0]
    assert not STILL[0].any()


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("torque_only", "user_wrench:torque_only: must return force and torque"),
        ("broken", "user_wrench:broken: failed at t = 0.25 s: ZeroDivisionError"),
    ],
)
def test_a_function_that_fails_is_named(
    name: str, part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a function raises, or gives instead of twice three numbers, is one line that names it."""
    load = called(name, tmp_path, monkeypatch)
    with pytest.raises(InputError, match=part) as caught:
        load.function(0.25, *STILL)
    assert "\n" not in str(caught.value)


def test_a_family_has_a_child_for_each_value(tmp_path: Path) -> None:
    """Children are named by their values, hold them, and are found by file and value, however written."""
    path = tmp_path / "family.toml"
    path.write_text(SWEPT)
    found = load_scenarios([path])
    assert [how for how, _ in found] == [f"{path}/0.001", f"{path}/1e-12"]
    assert [scenario.name for _, scenario in found] == ["good/0.001", "good/1e-12"]
    assert {scenario.family for _, scenario in found} == {"good"}
    assert [scenario.scene.initial.omega_body[0] for _, scenario in found] == [1e-3, 1e-12]
    for how, scenario in found:
        assert load_scenario(how) == scenario
    assert load_scenario(f"{path}/1e-3") == found[0][1]


def test_a_value_with_slashes_names_its_child(tmp_path: Path) -> None:
    """A family over mesh files in folders has children that are found by the names which they get."""
    (tmp_path / "parts").mkdir()
    corners = ("0 0 0", "1 0 0", "0 1 0", "0 0 1")
    faces = ("1 3 2", "1 2 4", "1 4 3", "2 3 4")
    lines = [*(f"v {corner}" for corner in corners), *(f"f {face}" for face in faces)]
    for name in ("a.obj", "b.obj"):
        (tmp_path / "parts" / name).write_text("\n".join([f"# {name}", *lines, ""]))
    path = tmp_path / "family.toml"
    path.write_text(
        'name = "parts"\nduration_s = 1.0\nsamples = 11\n[body]\nmesh = ""\ndensity_kg_m3 = 1.0\n'
        '[[sweep]]\nkey = "body.mesh"\nvalues = ["parts/a.obj", "parts/b.obj"]\n'
    )
    found = load_scenarios([path])
    assert [how for how, _ in found] == [f"{path}/parts/a.obj", f"{path}/parts/b.obj"]
    for how, scenario in found:
        assert load_scenario(how) == scenario


@pytest.mark.parametrize(
    ("child", "part"),
    [
        ("", "is a family; name one of its scenarios: "),
        ("/7", r"not in this family \(available: "),
        ("/x", "not in this family"),
    ],
)
def test_a_child_that_is_not_named_rightly_is_refused(child: str, part: str, tmp_path: Path) -> None:
    """Where one scenario is asked for, a family and a value it has not are refused with what there is."""
    path = tmp_path / "family.toml"
    path.write_text(SWEPT)
    with pytest.raises(InputError, match=part) as caught:
        load_scenario(f"{path}{child}")
    assert f"{path}/0.001, {path}/1e-12" in str(caught.value)
    path.write_text(GOOD)
    with pytest.raises(InputError, match="is a single scenario, not a family"):
        load_scenario(f"{path}/7")


def test_what_is_wrong_of_one_child_is_said_of_it() -> None:
    """A fault that all children share comes once, of the file; any other names its child."""
    text = SWEPT.replace("mass_kg = 2.0", "mass_kg = -2").replace("1e-12]", "'a']")
    shared, own = refusals(text)
    assert shared.startswith("file.toml: body.mass_kg: ")
    assert own.startswith("file.toml/a: initial.omega_body_rad_s[0]: ")


@pytest.mark.parametrize("value", ["true", "nan", "[1.0]", "1979-05-27", "0x1" + "0" * 300])
def test_a_value_that_is_no_number_or_text_is_one_fault(value: str) -> None:
    """One line names the value, and none follows from that."""
    (line,) = refusals(SWEPT.replace("1e-3, 1e-12", value))
    assert line.startswith("file.toml: sweep[0].values[0]: needs ")


def test_the_value_may_be_a_key_that_the_file_lacks() -> None:
    """A sweep may set a key whose table is there."""
    swept = "[[sweep]]\nkey = 'forcing[0].linear_n_s_m'\nvalues = [1, 2]\n"
    members = parse_members(GOOD + "[[forcing]]\nkind = 'drag'\n" + swept, "file.toml", HERE)
    drags = [load for scenario in members.values() for load in scenario.scene.loads]
    assert [load.linear for load in drags if isinstance(load, Drag)] == [1.0, 2.0]


LIBRARY = (
    *("sphere", "symmetric-top", "intermediate-axis", "tumbling", "full-tensor", "near-separatrix"),
    *("body-torque", "world-torque", "thruster", "boxes", "free-body", "pulsed-torque"),
    *("t-handle", "torus-spin-up", "free-flight", "powered-flight", "fast-flight"),
    "off-centre-link",
)
FORCED = suites()["forcings"]
HARD = suites()["hard"]


def test_the_library_is_listed() -> None:
    """The list by which the library is tested leaves none of it out."""
    assert sorted((*LIBRARY, *FORCED, *HARD, *PROBES)) == list(scenario_names())


@pytest.mark.parametrize("name", [*LIBRARY, *FORCED, *HARD, *PROBES])
def test_the_library_has_each_scenario_with_its_source(name: str) -> None:
    """A built-in scenario or family is found by name, says where it is from, and its tags fit its loads."""
    for _, scenario in load_scenarios([name]):
        assert scenario.family == name
        assert scenario.summary
        assert scenario.source
        assert ("torque-free" in scenario.tags) == scenario.scene.is_free_rotation
        assert ("forced" in scenario.tags) == (not scenario.scene.is_free_rotation)
        assert ("pivot" in scenario.tags) == (scenario.scene.pivot is not None)
        assert len(scenario.steps) >= 4 or "long" in scenario.tags


def test_suites_name_built_in_scenarios_only() -> None:
    """Every suite's members exist; standard, forcings and hard are all but the probes, as is full."""
    for members in suites().values():
        assert set(members) <= set(scenario_names())
    parts = (suites()[part] for part in ("standard", "forcings", "hard"))
    whole = [name for name in scenario_names() if name not in PROBES]
    assert sorted(name for part in parts for name in part) == sorted(suites()["full"]) == whole


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
    with pytest.raises(InputError, match="another scenario of this run is also named 'sphere'"):
        load_scenarios(["sphere", str(path)])


def test_unknown_names_say_what_there_is() -> None:
    """A name that is nothing lists the names that are something."""
    with pytest.raises(InputError, match=r"neither .* suites: smoke, standard, forcings, hard, full"):
        load_scenarios(["nope"])


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("Intermediate-Axis", "intermediate-axis"),
        ("intermediate axis", "intermediate-axis"),
        ("intermedate_axis", "intermediate-axis"),
        ("standart", "standard"),
        ("tumbling.tml", "tumbling"),
        ("mine", "mine.toml"),
    ],
)
def test_a_name_that_is_nearly_one_is_answered_by_that_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, typed: str, meant: str
) -> None:
    """A slip of the hand gets a short line with the name that was meant."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(GOOD)
    with pytest.raises(InputError) as refused:
        load_scenarios([typed])
    assert str(refused.value) == (
        f"{typed}: is neither a .toml file nor a built-in scenario or suite; did you mean {meant}?"
    )


def test_where_one_scenario_is_needed_a_suite_says_what_is_in_it() -> None:
    """The name is known, and the line does not say that it is not."""
    with pytest.raises(InputError) as refused:
        load_scenario("smoke")
    assert (
        str(refused.value) == f"smoke: is a suite; name one of its scenarios: {', '.join(suites()['smoke'])}"
    )
