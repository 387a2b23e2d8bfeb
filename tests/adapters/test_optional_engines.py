"""Tests at each push of the engines that run only on request; none of them needs to be installed."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bodycheck._util.errors import InputError
from bodycheck.adapters import registry
from bodycheck.adapters.contract import Engine, Reading, Setting, Stepping
from bodycheck.adapters.engine_names import Pin
from bodycheck.adapters.execution import Answer, Case, record
from bodycheck.adapters.optional.between_steps import BetweenSteps
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.registry import default_engines, engine_names, optional_engines, stated_by
from bodycheck.adapters.versions import environments
from bodycheck.adapters.workers import received_messages
from bodycheck.adapters.workers.case_messages import case_message
from bodycheck.adapters.workers.engine_pool import announced
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product, rotate
from bodycheck.reference_impl.scene import (
    Drag,
    GravityGradient,
    Load,
    PointForce,
    RigidBody,
    Scene,
    SineTorque,
    Spring,
    State,
    Torque,
    TorsionSpring,
)
from bodycheck.runs.selection import select
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.local_package_index import write_needed, write_wheel

ROOT = Path(__file__).parents[2]
NODE = Path(registry.__file__).parent / "optional/node"  # of the package that is tested, which may be a wheel
INERTIA = np.array([[1.0, 0.1, -0.2], [0.1, 1.6, 0.3], [-0.2, 0.3, 2.1]])
START = State(
    np.array([0.1, -0.2, 0.3]),
    np.array([0.8, 0.2, -0.4, 0.4]),
    np.array([0.5, -0.1, 0.2]),
    np.array([0.7, -1.1, 0.4]),
)
V = np.array([0.3, -0.2, 0.5])
LOADS: tuple[tuple[Load, ...], ...] = (
    (),
    (Torque("body", V, 0.13, 0.555), Torque("world", -V, 0.0, np.inf)),
    (PointForce("body", V, V, 0.0, 0.31), PointForce("world", V, 2.0 * V, 0.2, np.inf)),
    (SineTorque("body", V, 3.0, 0.4),),
    (Drag(0.4, np.diag([0.5, 0.8, 0.3])),),
    (Spring(-V, V, 12.0, 0.3),),
    (TorsionSpring(2.0),),
    (GravityGradient(1.5),),
)


def scene_under(loads: tuple[Load, ...]) -> Scene:
    """Return a body that tumbles and falls for 1 s, in 50 steps of 0.02 s."""
    return Scene(RigidBody(1.7, INERTIA), START, loads, np.array([0.3, 0.0, -9.81]), 1.0, 6)


def by_the_reference(scene: Scene) -> Answer:
    """Return the motion computed by the reference's map M1."""
    return record(Reference(), Case(scene, "m1", Setting(dt_s=0.02)))


def assert_same(found: Answer, expected: Answer) -> None:
    """Assert that two motions are equal to round-off."""
    assert found.trajectory is not None
    assert expected.trajectory is not None
    assert np.abs(found.trajectory.position_m - expected.trajectory.position_m).max() < 1e-12
    assert np.abs(found.trajectory.velocity_m_s - expected.trajectory.velocity_m_s).max() < 1e-12
    assert np.abs(found.trajectory.omega_body - expected.trajectory.omega_body).max() < 1e-12
    turns = np.abs(np.sum(found.trajectory.attitude * expected.trajectory.attitude, axis=1))
    assert np.abs(turns - 1.0).max() < 1e-12


# --------------------------------------------------------------------------------------- loads between steps


class _M1Body:
    """The map M1 in numpy, as an engine that takes a force and a torque between steps."""

    stepping: Stepping = "python"

    def __init__(self, scene: Scene, dt_s: float) -> None:
        self.scene, self.dt_s = scene, dt_s

    def model(self) -> tuple[float, Array, float, Array]:
        return self.scene.body.mass, self.scene.body.inertia, self.dt_s, self.scene.gravity

    def set_state(self, state: State) -> None:
        self.x, self.v, self.q, self.omega = (
            state.position,
            state.velocity,
            state.quaternion,
            state.omega_body,
        )

    def step(self, steps: int, force: Array, torque: Array) -> None:
        for _ in range(steps):
            in_body = rotate(self.q * [1.0, -1.0, -1.0, -1.0], torque)
            momentum = self.scene.body.inertia @ self.omega
            spin = np.linalg.solve(self.scene.body.inertia, in_body - np.cross(self.omega, momentum))
            self.omega = self.omega + self.dt_s * spin
            self.v = self.v + self.dt_s * (self.scene.gravity + force / self.scene.body.mass)
            self.x = self.x + self.dt_s * self.v
            self.q = quaternion_product(self.q, exp_quaternion(self.dt_s * self.omega))

    def read(self) -> Reading:
        return Reading(self.x, self.v, quaternion=self.q, omega_world=rotate(self.q, self.omega))


class _M1Engine:
    name, version = "m1-stand-in", "1"
    methods = {"m1": Reference().methods["m1"]}  # noqa: RUF012 - never changed

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract's signature
        return None

    def build(self, scene: Scene, method: str, dt_s: float) -> BetweenSteps:  # noqa: ARG002
        return BetweenSteps(scene, dt_s, _M1Body(scene, dt_s))


@pytest.mark.slow
@pytest.mark.nightly(after=3)
@pytest.mark.parametrize("loads", LOADS)
def test_loads_between_steps_are_those_of_the_map(loads: tuple[Load, ...]) -> None:
    """A body whose loads are applied between steps moves like the reference's map under these loads."""
    scene = scene_under(loads)
    case = Case(scene, "m1", Setting(dt_s=0.02))
    expected = by_the_reference(scene)
    assert_same(record(_M1Engine(), case), expected)
    assert_same(record(_M1Engine(), case, again=True), expected)


@pytest.fixture(scope="module")
def node_worker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[str]]:
    """Start the protocol of the JavaScript engines with a stand-in that needs no package."""
    if shutil.which("node") is None:
        pytest.skip("no node")
    folder = tmp_path_factory.mktemp("node")
    (folder / "package-lock.json").write_text("{}")
    package = folder / "node_modules" / "stand-in"
    package.mkdir(parents=True)
    (package / "package.json").write_text('{"version": "1.2.3"}')
    facts = json.loads((NODE / "cannon.json").read_text()) | {"name": "stand-in", "distribution": "stand-in"}
    (folder / "facts.json").write_text(json.dumps(facts))
    with subprocess.Popen(
        ["node", str(ROOT / "tests/helpers/m1_worker.mjs"), str(NODE), str(folder / "facts.json")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={"PATH": str(Path(shutil.which("node") or "").parent), environments.NODE_PACKAGES: str(folder)},
    ) as process:
        yield process
        assert process.stdin is not None
        process.stdin.close()
        assert process.wait(60) == 0


def answer_to(process: subprocess.Popen[str], **request: object) -> dict[str, object]:
    """Return the answer to a request."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(json.dumps({"id": 1, **request}) + "\n")
    process.stdin.flush()
    found: dict[str, object] = json.loads(process.stdout.readline())
    return found


def test_javascript_protocol_announces_what_its_facts_state(node_worker: subprocess.Popen[str]) -> None:
    """The announcement is valid with the version of the installed package, and loads act as in the map."""
    assert node_worker.stdout is not None
    engine, _ = received_messages.engine_of(json.loads(node_worker.stdout.readline()))
    assert (engine.name, engine.version) == ("stand-in", "1.2.3")
    assert engine.methods == {method.name: method for method in stated_by("cannon-es").methods.values()}
    for loads in LOADS:
        scene = scene_under(loads)
        message = case_message(Case(scene, "leapfrog", Setting(dt_s=0.02)))
        expected = by_the_reference(scene)
        for do in ("record", "replay"):
            answer = received_messages.answer_of(
                answer_to(node_worker, do=do, case=message), scene.sample_times
            )
            assert answer.outcome == "ok", answer.message
            assert_same(answer, expected)
    pivoted = case_message(Case(scene_under(()), "leapfrog", Setting(dt_s=0.02)))
    pivoted["scene"]["pivot"] = [0.0, 0.0, 1.0]
    assert answer_to(node_worker, do="record", case=pivoted)["outcome"] == "unsupported"
    assert answer_to(node_worker, do="something")["outcome"] == "failed"


# ------------------------------------------------------------------------ selection and environments


@pytest.mark.slow
def test_optional_engines_run_only_if_named() -> None:
    """A run without --engine contains none of them, although their names are known."""
    assert set(default_engines()).isdisjoint(optional_engines())
    assert set(optional_engines()) <= set(engine_names())
    selection = select(["free-flight"])
    assert {engine.name for engine, _ in selection.methods}.isdisjoint(optional_engines())


def test_stating_the_facts_imports_no_engine() -> None:
    """The facts of all optional engines can be read without importing any of them."""
    code = (
        "import sys\n"
        "from bodycheck.adapters.registry import optional_engines, stated_by\n"
        "print(sum(len(stated_by(name).methods) for name in optional_engines()))\n"
        "print(*sys.modules, sep='\\n')\n"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    count, *modules = output.splitlines()
    assert int(count) > 40
    engines = [
        "rapier3d",
        "pydrake",
        "pinocchio",
        "scipy",
        "heyoka",
        "newton",
        "warp",
        "mujoco",
        "jax",
        "sapien",
    ]
    assert set(modules).isdisjoint([*engines, "mujoco_warp", "exudyn"])


def test_extras_are_the_requirements_of_the_adapters() -> None:
    """`bodycheck[NAME]` installs the requirements of the adapter, for every engine on PyPI except SciPy."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for name in optional_engines():
        stated = stated_by(name)
        if hasattr(stated, "requires") and not hasattr(stated, "worker") and name != "scipy":
            assert tuple(extras[name]) == stated.requires, name


@pytest.mark.parametrize("name", optional_engines())
def test_facts_of_an_optional_engine_are_complete(name: str) -> None:
    """Each engine has a package to pin and a fair method; a method with @defaults changes no default."""
    stated = stated_by(name)
    assert stated.name == name
    assert registry.distribution_of(name) == getattr(stated, "distribution", None)
    assert hasattr(stated, "requires") is not hasattr(stated, "system_library")
    assert any("@" not in method for method in stated.methods)
    for key, method in stated.methods.items():
        assert key == method.name
        assert method.snippet
        assert not (key.endswith("@defaults") and method.changed_defaults)


@pytest.mark.parametrize(
    ("name", "version", "requirements"),
    [
        ("drake", "1.51.1", ["drake==1.51.1"]),
        ("mjx", "3.17.0", ["mujoco-mjx==3.17.0", "jax"]),
        ("jolt-js", "1.1.0", ["jolt-physics@1.1.0"]),
        ("rapier-js", "0.21.0", ["@dimforge/rapier3d-compat@0.21.0"]),
        ("newton", None, ["newton[sim]>=1.8"]),
        ("newton", "1.8.0", ["newton[sim]==1.8.0"]),
    ],
)
def test_pin_selects_the_release_of_the_engine(
    name: str, version: str | None, requirements: list[str]
) -> None:
    """A pin replaces the requirement of the engine's package and keeps the others."""
    assert environments.requirements_of(Pin(name, version)) == requirements


def test_javascript_engine_runs_its_worker_by_node(monkeypatch: pytest.MonkeyPatch) -> None:
    """Node gets the worker and the folder of its packages; an engine in Python has no program."""
    monkeypatch.setattr(environments, "_made", lambda pin: Path("/made") / pin.name)
    program = environments.program_in(Pin("cannon-es", None))
    assert program is not None
    assert program.command == ["node", str(NODE / "cannon.mjs")]
    assert program.environment == {environments.NODE_PACKAGES: "/made/cannon-es"}
    assert environments.program_in(Pin("drake", None)) is None


# ----------------------------------------------------------------------------- environments of plug-ins

PLUG_IN = """
from bodycheck.adapters.contract import Method


class Needy:
    name = "needy"
    distribution = "toy-engine"
    requires = ("toy-engine>=2",)
    methods = {"m1": Method("m1", "map M1", 1, 1, "zero-order hold", "nothing", "made up")}

    def __init__(self):
        import toy_engine

        self.version = toy_engine.VERSION

    def unsupported(self, scene, method):
        return None

    def build(self, scene, method, dt_s):
        from bodycheck.adapters.reference import FixedStep
        from bodycheck.reference_impl.integrators import INTEGRATORS

        return FixedStep(scene, INTEGRATORS["m1"], dt_s)
"""


@pytest.fixture
def needy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Install a plug-in whose engine is only in a folder of wheels, and return that folder."""
    wheels, here = tmp_path / "wheels", tmp_path / "here"
    wheels.mkdir()
    write_needed(wheels)
    points = "[bodycheck.adapters]\nneedy = needy_plugin:Needy\n"
    plug_in = write_wheel(wheels, "needy_plugin", "0.1", {"needy_plugin.py": PLUG_IN}, points)
    shutil.unpack_archive(plug_in, here, "zip")
    monkeypatch.syspath_prepend(str(here))
    monkeypatch.setattr(environments, "cache_dir", lambda: tmp_path / "cache")
    for variable, value in (("UV_FIND_LINKS", str(wheels)), ("UV_NO_INDEX", "1"), ("UV_OFFLINE", "1")):
        monkeypatch.setenv(variable, value)
    registry._plugged_in.cache_clear()
    assert "needy" in registry._plugged_in()
    yield wheels
    registry._plugged_in.cache_clear()
    registry._import.cache_clear()


@pytest.mark.parametrize(
    ("origin", "requirements", "folder"),
    [
        (None, ["needy-plugin==0.1"], None),
        ("https://example.org/needy.whl", ["needy-plugin==0.1"], None),
        ("file:///home/me/my%20needy", ["toy-engine>=2", "numpy"], "/home/me/my needy"),
    ],
)
def test_plug_in_is_installed_from_where_it_is(
    origin: str | None, requirements: list[str], folder: str | None, needy: Path
) -> None:
    """A plug-in from a local folder is built there without extras; any other comes from the index."""
    facts = next((needy.parent / "here").glob("*.dist-info"))
    if origin is not None:
        (facts / "direct_url.json").write_text(json.dumps({"url": origin}))
    with (facts / "METADATA").open("a") as file:
        file.write(
            'Requires-Dist: toy-engine>=2\nRequires-Dist: numpy\nRequires-Dist: pytest; extra == "test"\n'
        )
    found, place = environments._plug_in(Pin("needy", None))
    assert ([one.replace("_", "-") for one in found], place) == (requirements, folder)


@pytest.mark.slow
def test_plug_in_runs_in_an_environment_of_its_own(needy: Path) -> None:
    """The engine that an adapter requires is installed into an environment that is listed and removable."""
    for release in ("1.0", "2.5"):
        write_wheel(needy, "toy_engine", release, {"toy_engine.py": f"VERSION = '{release}'\n"})
    engine = announced(["needy"])["needy"]
    assert isinstance(engine, Engine), engine
    assert engine.version == "2.5"
    pinned = announced(["needy==1.0"])["needy==1.0"]
    assert isinstance(pinned, Engine), pinned
    assert pinned.version == "1.0"
    found = environments.environments()
    assert [one.name for one in found] == ["needy", "needy==1.0"]
    for one in found:
        environments.remove(one)
    assert environments.environments() == []
    (needy.parent / "here/needy_plugin.py").write_text(
        PLUG_IN.replace("    requires = ", '    requires_python = "==3.2"\n    requires = ')
    )
    reason = announced(["needy"])["needy"]
    assert isinstance(reason, str)
    assert reason.startswith("needy cannot be installed: ")


@pytest.mark.slow
@pytest.mark.usefixtures("needy")
def test_engine_that_cannot_be_installed_is_unavailable_with_the_reason(
    expected_message: ExpectedMessage,
) -> None:
    """Requesting the engine is an error of one line that names the missing package."""
    with expected_message.raises(InputError) as error:
        select(["free-flight"], ["needy"])
    assert "\n" not in str(error.value)
    assert environments.environments() == []
