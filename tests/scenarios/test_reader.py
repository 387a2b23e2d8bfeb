"""The scenario format: every key, every refusal, and all errors of a file in one reading."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from bodycheck._util.errors import InputError
from bodycheck.reference_impl.loads import load_kinds
from bodycheck.reference_impl.loads.load import ContinuousLoad
from bodycheck.reference_impl.scene import (
    CallbackLoad,
    Drag,
    GravityGradient,
    SineTorque,
    Spring,
    TorsionSpring,
)
from bodycheck.scenarios.library import (
    OF_NO_SUITE,
    PROBES,
    load_scenario,
    load_scenarios,
    scenario_names,
    suites,
    tree_names,
)
from bodycheck.scenarios.model import Scenario
from bodycheck.scenarios.reader import parse_members
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.scenario_parsing import HERE, parse_scenario

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
    """Return the scenario that this text defines."""
    return parse_scenario(base + addition, "file.toml")


def refusals(text: str) -> list[str]:
    """Return the error lines with which this text is refused."""
    with pytest.raises(InputError) as caught:
        parse_members(text, "file.toml", HERE)
    return str(caught.value).splitlines()


def test_minimal_file_starts_at_rest_at_the_origin() -> None:
    """Every key of [initial] is optional; by default the body is at rest at the origin with aligned axes."""
    start = parsed().scene.initial
    assert start.quaternion.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert not np.any([start.position, start.velocity, start.omega_body])


def test_times_are_computed_from_the_sample_number() -> None:
    """Sample k is at k T / (n - 1)."""
    times = parsed().scene.sample_times
    assert times.tolist() == [k * 2.0 / 20 for k in range(21)]


def test_omega_in_world_axes_is_rotated_into_body_axes() -> None:
    """omega_world_rad_s is R omega_body."""
    half = math.sqrt(0.5)
    scene = parsed(
        f"[initial]\nquaternion = [{half!r}, 0, 0, {half!r}]\nomega_world_rad_s = [1, 2, 3]\n"
    ).scene
    assert scene.initial.omega_body == pytest.approx([2.0, -1.0, 3.0], abs=1e-15)


def test_engines_get_a_unit_quaternion_and_the_truth_the_one_of_the_file() -> None:
    """A quaternion within 1e-6 of unit length is normalised for engines, but unchanged for the truth."""
    scenario = parsed("[initial]\nquaternion = [1.0000005, 0, 0, 0]\n")
    assert scenario.scene.initial.quaternion.tolist() == [1.0, 0.0, 0.0, 0.0]
    assert scenario.scene_as_written.initial.quaternion.tolist() == [1.0000005, 0.0, 0.0, 0.0]
    assert scenario.initial.quaternion == (1.0000005, 0.0, 0.0, 0.0)


def test_unit_quaternion_is_unchanged() -> None:
    """A norm that is off by two ulps does not change the digits of the file."""
    written = [0.5, 0.5, 0.5, 0.500000000000001]
    assert math.hypot(*written) > 1.0
    scenario = parsed(f"[initial]\nquaternion = {written}\n")
    assert scenario.scene.initial.quaternion.tolist() == written


def test_truth_starts_from_omega_as_written() -> None:
    """Engines get omega in body axes, rounded; the initial state stores it in world axes."""
    scenario = parsed("[initial]\nquaternion = [0.6, 0.8, 0, 0]\nomega_world_rad_s = [1, 2, 3]\n")
    assert scenario.scene.initial.exact_omega_world is None
    exact = scenario.scene_as_written.initial.exact_omega_world
    assert exact is not None
    assert exact.tolist() == [1.0, 2.0, 3.0]
    assert np.array_equal(scenario.scene_as_written.initial.omega_body, scenario.scene.initial.omega_body)


def test_full_tensor_is_unchanged() -> None:
    """The off-diagonal numbers are the tensor's entries, I_xy = -sum m x y."""
    rows = "[[0.9, 0.04, -0.03], [0.04, 1.1, 0.02], [-0.03, 0.02, 1.3]]"
    scene = parsed(base=GOOD.replace("[1.0, 2.0, 2.5]", rows)).scene
    assert scene.body.inertia[0].tolist() == [0.9, 0.04, -0.03]


def test_forcings_become_loads_and_gravity() -> None:
    """A torque and a force keep their times, and accelerations of gravity are summed."""
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
    "unknown key": GOOD.replace("mass_kg", "mas_kg"),
    "unknown table": GOOD + "[other]\n",
    "text for a number": GOOD.replace("2.0\nsam", '"2"\nsam'),
    "truth for a number": GOOD.replace("mass_kg = 2.0", "mass_kg = true"),
    "number for text": GOOD.replace('"good"', "3"),
    "empty name": GOOD.replace('"good"', '""'),
    "name of two lines": GOOD.replace('"good"', r'"a\nb"'),
    "name with a slash": GOOD.replace('"good"', '"a/b"'),
    "family's name with a slash": SWEPT.replace('"good"', '"a/b"'),
    "no duration": GOOD.replace("duration_s = 2.0", ""),
    "negative duration": GOOD.replace("2.0\nsam", "-2.0\nsam"),
    "infinite duration": GOOD.replace("2.0\nsam", "inf\nsam"),
    "huge whole number": GOOD.replace("2.0\nsam", "1" + 400 * "0" + "\nsam"),
    "one sample": GOOD.replace("21", "1"),
    "half a sample": GOOD.replace("21", "21.5"),
    "too many samples": GOOD.replace("21", "10000000"),
    "NaN mass": GOOD.replace("mass_kg = 2.0", "mass_kg = nan"),
    "zero mass": GOOD.replace("mass_kg = 2.0", "mass_kg = 0"),
    "NaN inertia": GOOD.replace("[1.0, 2.0", "[nan, 2.0"),
    "negative inertia": GOOD.replace("[1.0, 2.0", "[-1.0, 2.0"),
    "impossible body": GOOD.replace("2.5]", "5.0]"),
    "DETEST B5's body": BODY + "mass_kg = 1\ninertia_kg_m2 = [1, 1, 0]\n",
    "two moments": GOOD.replace("[1.0, 2.0, 2.5]", "[1.0, 2.0]"),
    "ragged tensor": GOOD.replace("[1.0, 2.0, 2.5]", "[[1, 0], [0, 1, 0], [0]]"),
    "text in a tensor": GOOD.replace("[1.0, 2.0", '["1", 2.0'),
    "unsymmetric tensor": GOOD.replace("[1.0, 2.0, 2.5]", "[[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]"),
    "published heavy top": BODY + "mass_kg = 20\ninertia_kg_m2 = [-15, -15, 1]\n",
    "two numbers of a link": GOOD + "link_offset_m = [0, 1]\n",
    "long link quaternion": GOOD + "link_quaternion = [0, 0, 0, 2]\n",
    **{
        f"sweep, {what}": GOOD + f"[[sweep]]\n{text}\n"
        for what, text in (
            ("no key", "values = [1]"),
            ("no values", "key = 'duration_s'"),
            ("empty values", "key = 'duration_s'\nvalues = []"),
            ("NaN", "key = 'duration_s'\nvalues = [nan]"),
            ("a value twice", "key = 'duration_s'\nvalues = [1, 1.0]"),
            ("a name", "key = 'name'\nvalues = ['a']"),
            ("no path", "key = 'a..b'\nvalues = [1]"),
            ("nowhere", "key = 'forcing[0].at_m[0]'\nvalues = [1]"),
            ("beyond a list", "key = 'body.inertia_kg_m2[3]'\nvalues = [1]"),
            ("into a number", "key = 'duration_s.x'\nvalues = [1]"),
            ("twice", "key = 'samples'\nvalues = [3]\n[[sweep]]\nkey = 'samples'\nvalues = [4]"),
            ("no list", "key = 3\nvalues = 3"),
        )
    },
    "sweep that is a number": "sweep = 3\n" + GOOD,
    "long quaternion": GOOD + "[initial]\nquaternion = [1, 1, 0, 0]\n",
    "spin whose square is infinite": GOOD + "[initial]\nomega_body_rad_s = [1e200, 0, 0]\n",
    "zero quaternion": GOOD + "[initial]\nquaternion = [0, 0, 0, 0]\n",
    "three numbers of four": GOOD + "[initial]\nquaternion = [1, 0, 0]\n",
    "two omegas": GOOD + "[initial]\nomega_body_rad_s = [1, 2, 3]\nomega_world_rad_s = [1, 2, 3]\n",
    "four components": GOOD + "[initial]\nvelocity_m_s = [1, 2, 3, 4]\n",
    "forcing without a kind": GOOD + '[[forcing]]\naxes = "body"\n',
    "unknown kind": GOOD + '[[forcing]]\nkind = "magic"\n',
    "forcing is no table": GOOD.replace("[body]", "forcing = [3]\n[body]"),
    "unknown axes": GOOD + '[[forcing]]\nkind = "torque"\naxes = "link"\nvalue_n_m = [1, 0, 0]\n',
    "ends before it begins": GOOD
    + '[[forcing]]\nkind = "torque"\naxes = "body"\nvalue_n_m = [1, 0, 0]\nfrom_s = 2\nuntil_s = 1\n',
    "step that does not divide": GOOD.replace("samples = 21", "samples = 21\nsteps_s = [0.1, 0.03]"),
    "degrees in a key": GOOD + "[initial]\nomega_body_deg_s = [0, 1, 0]\n",
    "a key without its unit": GOOD.replace("duration_s", "duration"),
    "negative step": GOOD.replace("samples = 21", "samples = 21\nsteps_s = [-0.1]"),
    "a step twice": GOOD.replace("samples = 21", "samples = 21\nsteps_s = [0.1, 0.05, 0.1]"),
    "nested too deeply": "a = " + "[" * 3000 + "]" * 3000,
    "no steps": GOOD.replace("samples = 21", "samples = 21\nsteps_s = []"),
    "not TOML": "name = ",
    **{
        f"{kind} without {key}": GOOD + f'[[forcing]]\nkind = "{kind}"\n'
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
        f"{kind} with {key} = {value}": GOOD + f'[[forcing]]\nkind = "{kind}"\n{key} = {value}\n'
        for kind, key, value in (
            ("drag", "linear_n_s_m", "-1"),
            ("drag", "linear_n_s_m", "nan"),
            ("drag", "angular_n_m_s", "-0.1"),
            ("drag", "angular_n_m_s", "[[1, 3, 0], [3, 1, 0], [0, 0, 1]]"),
            ("drag", "angular_n_m_s", "[1, 2, 3]"),
            ("drag", "angular_n_m_s", "[[1, 0], [0]]"),
            ("drag", "angular_n_m_s", "true"),
            ("drag", "angular_n_m_s", "inf"),
            ("spring", "stiffness_n_m", "0"),
            ("spring", "rest_length_m", "-1"),
            ("spring", "anchor_m", "[0, 0]"),
            ("torsion-spring", "stiffness_n_m", "-1"),
            ("gravity-gradient", "orbit_rate_rad_s", "0"),
            ("sine-torque", "rate_rad_s", "nan"),
            ("sine-torque", "axes", "'link'"),
            ("sine-torque", "until_s", "1"),
            ("pivot", "at_m", "[0, 0, nan]"),
            ("callable", "function", "3"),
            ("callable", "function", "'wrench'"),
            ("callable", "function", "'os:getcwd'"),
        )
    },
    "two pivots": GOOD + 2 * '[[forcing]]\nkind = "pivot"\nat_m = [0, 0, 1]\n',
    "two orbits": GOOD + 2 * '[[forcing]]\nkind = "gravity-gradient"\norbit_rate_rad_s = 1\n',
    "pivot in orbit": GOOD
    + '[[forcing]]\nkind = "pivot"\nat_m = [0, 0, 1]\n'
    + '[[forcing]]\nkind = "gravity-gradient"\norbit_rate_rad_s = 1\n',
    "velocity that moves the pivot": GOOD
    + "[initial]\nomega_body_rad_s = [1, 0, 0]\nvelocity_m_s = [0, -1, 0]\n"
    + '[[forcing]]\nkind = "pivot"\nat_m = [0, 0, 1]\n',
}


@pytest.mark.parametrize("fault", FAULTS)
def test_each_error_is_refused_with_its_key(fault: str, expected_message: ExpectedMessage) -> None:
    """Each invalid file is refused by a line with the place and the valid form."""
    expected_message("\n".join(refusals(FAULTS[fault])))


def test_all_errors_of_a_file_are_reported_at_once() -> None:
    """One reading reports every error on one line each, including those that concern two keys."""
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


def test_plate_on_the_limit_is_accepted() -> None:
    """I1 + I2 = I3 is a flat plate, which is a possible body; so is a violation below 1e-12."""
    for third in ("3.0", "3.0000000000001"):
        parsed(base=GOOD.replace("2.5]", f"{third}]"))


def test_unreadable_files_are_named(tmp_path: Path) -> None:
    """A missing file, a folder and binary data are each refused in one line with the file's name."""
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    for path, reason in ((tmp_path / "no.toml", "No such file"), (tmp_path, "directory"), (binary, "UTF-8")):
        with pytest.raises(InputError, match=reason) as caught:
            load_scenario(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def pivoted(initial: str) -> Scenario:
    """Return the valid scenario about a pivot 0.5 m below its centre of mass."""
    return parsed(f'[initial]\n{initial}\n[[forcing]]\nkind = "pivot"\nat_m = [0, 0, -0.5]\n')


@pytest.mark.parametrize("text", [GOOD, SWEPT], ids=["alone", "family"])
@pytest.mark.parametrize("value", ["1" * 5000, "[" * 5000 + "]" * 5000], ids=["digits", "lists"])
def test_excessive_numbers_and_lists_are_refused(
    value: str, text: str, expected_message: ExpectedMessage
) -> None:
    """Numbers and lists that are too large to parse are refused in one line, also in a family."""
    expected_message("\n".join(refusals(f"foo = {value}\n{text}")))


def test_centre_moves_with_the_rotation_about_a_pivot() -> None:
    """v = omega x (x - pivot) in world axes, whether the file omits it or gives it to nine digits."""
    half = math.sqrt(0.5)
    turned = f"quaternion = [{half!r}, {half!r}, 0, 0]\nomega_body_rad_s = [1, 2, 3]"
    scene = pivoted(turned).scene
    assert scene.pivot is not None
    # R takes z to -y: the centre is 0.5 m along -y from the pivot, and omega is (1, -3, 2)
    expected = np.cross([1.0, -3.0, 2.0], [0.0, -0.5, 0.0])
    assert scene.initial.velocity == pytest.approx(expected, abs=1e-15)
    explicit = pivoted(turned + f"\nvelocity_m_s = {(expected * (1.0 + 1e-10)).tolist()}").scene
    assert np.array_equal(explicit.initial.velocity, scene.initial.velocity)


def test_each_kind_of_forcing_becomes_its_load() -> None:
    """Every key of every kind is used, an angular drag may be a single number, and defaults are zero."""
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


def test_link_frame_is_read() -> None:
    """Missing parts default to the centre of mass and the body axes; without any part there is no link."""
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
    """Return the load that a function of WRENCH becomes if code is allowed."""
    (folder / "user_wrench.py").write_text(WRENCH)
    monkeypatch.chdir(folder)
    text = f'[[forcing]]\nkind = "callable"\nfunction = "user_wrench:{name}"\n'
    (load,) = parse_scenario(GOOD + text, "file.toml", allow_code=True).scene.loads
    assert isinstance(load, CallbackLoad)
    return load


def test_callback_load_is_imported_where_code_is_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The function gets copies, and its force and torque are returned as arrays."""
    load = called("wrench", tmp_path, monkeypatch)
    force, torque = load.function(0.25, *STILL)
    assert force.tolist() == [0.25, 2.0, 3.0]
    assert torque.tolist() == [-1.0, -1.0, -1.0]
    assert not STILL[0].any()


@pytest.mark.parametrize("name", ["torque_only", "broken"])
def test_failing_callback_load_is_named(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """An exception, or a result that is not two times three numbers, is one line with the function's name."""
    load = called(name, tmp_path, monkeypatch)
    with pytest.raises(InputError) as caught:
        load.function(0.25, *STILL)
    expected_message(str(caught.value))


def test_family_has_a_child_for_each_value(tmp_path: Path) -> None:
    """Children are named after their values and found by file and value in any notation."""
    path = tmp_path / "family.toml"
    path.write_text(SWEPT)
    found = load_scenarios([path])
    assert [spec for spec, _ in found] == [f"{path}/0.001", f"{path}/1e-12"]
    assert [scenario.name for _, scenario in found] == ["good/0.001", "good/1e-12"]
    assert {scenario.family for _, scenario in found} == {"good"}
    assert [scenario.scene.initial.omega_body[0] for _, scenario in found] == [1e-3, 1e-12]
    for spec, scenario in found:
        assert load_scenario(spec) == scenario
    assert load_scenario(f"{path}/1e-3") == found[0][1]


def test_value_with_slashes_names_its_child(tmp_path: Path) -> None:
    """A family over mesh files in folders has children that are found by their names."""
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
    assert [spec for spec, _ in found] == [f"{path}/parts/a.obj", f"{path}/parts/b.obj"]
    for spec, scenario in found:
        assert load_scenario(spec) == scenario


@pytest.mark.parametrize(
    ("child", "text"),
    [("", SWEPT), ("/7", SWEPT), ("/x", SWEPT), ("/7", GOOD)],
    ids=["none", "unknown", "no number", "no family"],
)
def test_wrong_child_is_refused(
    child: str, text: str, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """A family instead of one scenario, or an unknown value, is refused with a list of the known ones."""
    path = tmp_path / "family.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_scenario(f"{path}{child}")
    expected_message(str(caught.value), tmp_path)


def test_error_of_one_child_names_the_child() -> None:
    """An error common to all children is reported once for the file; any other one names its child."""
    text = SWEPT.replace("mass_kg = 2.0", "mass_kg = -2").replace("1e-12]", "'a']")
    shared, own = refusals(text)
    assert shared.startswith("file.toml: body.mass_kg: ")
    assert own.startswith("file.toml/a: initial.omega_body_rad_s[0]: ")


@pytest.mark.parametrize("value", ["true", "nan", "[1.0]", "1979-05-27", "0x1" + "0" * 300])
def test_value_of_a_wrong_type_is_one_error(value: str) -> None:
    """One line names the value, and no further error follows from it."""
    (line,) = refusals(SWEPT.replace("1e-3, 1e-12", value))
    assert line.startswith("file.toml: sweep[0].values[0]: needs ")


def test_sweep_may_set_a_whole_number() -> None:
    """A key that requires one gets it."""
    members = parse_members(GOOD + "[[sweep]]\nkey = 'samples'\nvalues = [3, 5]\n", "file.toml", HERE)
    assert [scenario.scene.samples for scenario in members.values()] == [3, 5]


def test_sweep_may_set_an_absent_key() -> None:
    """A sweep may set a key whose table exists."""
    swept = "[[sweep]]\nkey = 'forcing[0].linear_n_s_m'\nvalues = [1, 2]\n"
    members = parse_members(GOOD + "[[forcing]]\nkind = 'drag'\n" + swept, "file.toml", HERE)
    drags = [load for scenario in members.values() for load in scenario.scene.loads]
    assert [load.linear for load in drags if isinstance(load, Drag)] == [1.0, 2.0]


LIBRARY = (
    *("sphere", "symmetric-top", "intermediate-axis", "tumbling", "full-tensor", "near-separatrix"),
    *("body-torque", "world-torque", "thruster", "boxes", "free-body", "pulsed-torque"),
    *("t-handle", "torus-spin-up", "free-flight", "powered-flight", "fast-flight"),
    *("off-centre-link", "fast-rotor"),
)
FORCED = suites()["forcings"]
HARD = suites()["hard"]


def test_library_list_is_complete() -> None:
    """The list that is used to test the library contains every file."""
    assert sorted((*LIBRARY, *FORCED, *HARD, *PROBES, *OF_NO_SUITE)) == list(scenario_names())


@pytest.mark.parametrize("name", [*LIBRARY, *FORCED, *HARD, *PROBES, *OF_NO_SUITE])
def test_library_scenario_has_its_source(name: str) -> None:
    """A built-in scenario or family is found by name, has a source, and its tags match its loads."""
    for _, scenario in load_scenarios([name]):
        assert scenario.family == name
        assert scenario.summary
        assert scenario.source
        assert ("torque-free" in scenario.tags) == scenario.scene.is_free_rotation
        assert ("forced" in scenario.tags) == (not scenario.scene.is_free_rotation)
        assert ("pivot" in scenario.tags) == (scenario.scene.pivot is not None)
        assert len(scenario.steps) >= 4 or "long" in scenario.tags


def test_suites_contain_built_in_scenarios() -> None:
    """Every member exists; standard, forcings, hard and trees, like full, have all but probes, recordings."""
    for members in suites().values():
        assert set(members) <= {*scenario_names(), *tree_names()}
    parts = (suites()[part] for part in ("standard", "forcings", "hard", "trees"))
    whole = {name for name in (*scenario_names(), *tree_names()) if name not in (*PROBES, *OF_NO_SUITE)}
    assert {name for part in parts for name in part} == {*suites()["full"]} == whole


def test_tag_selects_the_suite() -> None:
    """The members of forcings and hard are those with the tag, and no member of standard has either tag."""
    for name, scenario in load_scenarios(["full"]):
        (suite,) = {"forcings", "hard"} & {*scenario.tags} or {"standard"}
        assert scenario.family in suites()[suite], name


def test_every_continuous_load_has_a_scenario() -> None:
    """The suite forcings contains each kind of continuous load except a callback, which is a user's code."""
    found = {load.kind for _, scenario in load_scenarios(["forcings"]) for load in scenario.scene.loads}
    kinds = {kind for kind, load in load_kinds().items() if issubclass(load, ContinuousLoad)}
    assert kinds - found == {CallbackLoad.kind}


def test_names_suites_and_paths_may_be_mixed(tmp_path: Path) -> None:
    """A scenario requested twice is returned once, and each stores how it was requested."""
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    specs = ["sphere", str(path), "smoke", "sphere"]
    assert [spec for spec, _ in load_scenarios(specs)] == ["sphere", str(path), *suites()["smoke"]]


def test_different_scenarios_of_one_name_are_refused(
    tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """Rows of two scenarios must not be mixed under one name."""
    path = tmp_path / "mine.toml"
    path.write_text(GOOD.replace("good", "sphere"))
    with pytest.raises(InputError) as caught:
        load_scenarios(["sphere", str(path)])
    expected_message(str(caught.value), tmp_path)


def test_unknown_name_lists_the_known_names(expected_message: ExpectedMessage) -> None:
    """The error for an unknown name lists the built-in scenarios and suites."""
    with expected_message.raises(InputError):
        load_scenarios(["nope"])


@pytest.mark.parametrize(
    ("typed", "suggestion"),
    [
        ("Intermediate-Axis", "intermediate-axis"),
        ("intermediate axis", "intermediate-axis"),
        ("intermedate_axis", "intermediate-axis"),
        ("standart", "standard"),
        ("tumbling.tml", "tumbling"),
        ("mine", "mine.toml"),
    ],
)
def test_misspelt_name_suggests_the_nearest(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    typed: str,
    suggestion: str,
    expected_message: ExpectedMessage,
) -> None:
    """A misspelt name is refused in a short line with the nearest valid name."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(GOOD)
    with pytest.raises(InputError) as refused:
        load_scenarios([typed])
    assert f" {suggestion}" in str(refused.value)
    expected_message(str(refused.value))


def test_suite_in_the_place_of_a_scenario_lists_its_members(expected_message: ExpectedMessage) -> None:
    """The error lists the members and does not call the suite's name unknown."""
    with pytest.raises(InputError) as refused:
        load_scenario("smoke")
    expected_message(str(refused.value))
