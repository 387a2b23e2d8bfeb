"""A scene sent to a worker arrives unchanged."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bodycheck.adapters.contract import Adapter
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.workers.case_messages import scene_message, scene_of
from bodycheck.adapters.workers.protocol import line_of, message_of
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.scene import CallbackLoad, Scene
from bodycheck.scenarios.library import load_scenario, load_scenarios
from tests.helpers.scenario_parsing import parse_scenario

LIBRARY = [how for how, _ in load_scenarios(["standard", "forcings"])]


def there_and_back(scene: Scene) -> Scene:
    """Return the scene that is read from its own message."""
    return scene_of(message_of(line_of(scene_message(scene))))


def same(one: Any, other: Any) -> bool:
    """Return whether two holders of arrays are equal to the last bit."""
    if type(one) is not type(other):
        return False
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if hasattr(one, "__dataclass_fields__"):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    return bool(one == other)


@pytest.mark.parametrize("name", LIBRARY)
def test_scene_survives_its_message(name: str) -> None:
    """Body, initial state, loads of every kind, gravity and pivot are equal to the last bit."""
    scene = load_scenario(name).scene
    assert same(there_and_back(scene), scene)


LINKED = """
name = "linked"
duration_s = 1.0
samples = 11
[body]
mass_kg = 1.0
inertia_kg_m2 = [1.0, 2.0, 2.5]
link_offset_m = [0.1, 0.2, 0.3]
link_quaternion = [0.6, 0.0, 0.8, 0.0]
"""


def test_link_frame_survives_its_message() -> None:
    """The link frame arrives unchanged."""
    scene = parse_scenario(LINKED, "linked.toml").scene
    assert scene.link is not None
    assert same(there_and_back(scene), scene)


def test_callback_load_is_sent_as_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The worker imports the function by its name and evaluates it."""
    (tmp_path / "my_wrench_here.py").write_text("def f(t, x, r, v, w):\n    return [t, 0, 0], -w\n")
    monkeypatch.chdir(tmp_path)
    text = LINKED + '[[forcing]]\nkind = "callable"\nfunction = "my_wrench_here:f"\n'
    scene = parse_scenario(text, "linked.toml", allow_code=True).scene
    assert scene_message(scene)["loads"] == [{"kind": "callable", "name": "my_wrench_here:f"}]
    (load,) = there_and_back(scene).loads
    assert isinstance(load, CallbackLoad)
    force, torque = load.function(0.5, np.zeros(3), np.eye(3), np.zeros(3), np.ones(3))
    assert force.tolist() == [0.5, 0.0, 0.0]
    assert torque.tolist() == [-1.0, -1.0, -1.0]


@pytest.mark.parametrize("name", LIBRARY)
def test_reference_refuses_unsupported_scenes_with_a_reason(name: str) -> None:
    """Each method either states why it does not support a scene or builds it without error."""
    adapter: Adapter = Reference()
    scene = load_scenario(name).scene
    assert adapter.unsupported(scene, "taylor") is None
    for method, facts in adapter.methods.items():
        reason = adapter.unsupported(scene, method)
        if reason is None and facts.control == "dt":
            adapter.build(scene, method, scene.sample_interval_s).close()
        assert reason is None or reason.isprintable()


def test_reference_supports_callback_loads_where_it_can(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Methods that evaluate loads in compiled code refuse callback loads with a reason."""
    (tmp_path / "asked_by_the_reference.py").write_text("def f(t, x, r, v, w):\n    return -v, -w\n")
    monkeypatch.chdir(tmp_path)
    text = LINKED + '[[forcing]]\nkind = "callable"\nfunction = "asked_by_the_reference:f"\n'
    scene = parse_scenario(text, "linked.toml", allow_code=True).scene
    adapter: Adapter = Reference()
    reasons = {name: adapter.unsupported(scene, name) for name in adapter.methods}
    compiled = [m.name for m in INTEGRATORS.values() if m.continuous == "every stage" and m.tableau is None]
    single = [name for name, method in adapter.methods.items() if method.precision == "float32"]
    refused = {"exact": "closed form", "taylor": "series", **dict.fromkeys(compiled, "compiled")}
    refused |= dict.fromkeys(single, "constant loads")
    assert {name for name, reason in reasons.items() if reason} == set(refused)
    assert all(words in (reasons[name] or "") for name, words in refused.items())
