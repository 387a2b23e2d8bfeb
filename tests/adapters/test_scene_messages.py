"""A scene that travels to a worker and back is the same scene."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario_text import parse_scenario

from bodycheck.adapters.contract import Adapter
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.workers.case_messages import scene_message, scene_of
from bodycheck.adapters.workers.protocol import line_of, message_of
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.scene import CallbackLoad, Scene
from bodycheck.scenarios.library import load_scenario, load_scenarios

LIBRARY = [how for how, _ in load_scenarios(["standard", "forcings"])]


def there_and_back(scene: Scene) -> Scene:
    """Return what the line of a scene says."""
    return scene_of(message_of(line_of(scene_message(scene))))


def same(one: Any, other: Any) -> bool:
    """Whether two holders of arrays are equal to the last bit."""
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
def test_a_scene_survives_its_message(name: str) -> None:
    """Body, start, loads of every kind, gravity, pivot: equal to the last bit."""
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


def test_a_link_frame_survives_its_message() -> None:
    """The frame in which an engine is to be built is the worker's to know."""
    scene = parse_scenario(LINKED, "linked.toml").scene
    assert scene.link is not None
    assert same(there_and_back(scene), scene)


def test_a_function_travels_as_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The worker imports it by that name, and asks the same function."""
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
def test_the_reference_refuses_what_it_cannot_by_a_reason(name: str) -> None:
    """Each of its methods either says why it is not for a scene, or is made for it without an error."""
    adapter: Adapter = Reference()
    scene = load_scenario(name).scene
    assert adapter.unsupported(scene, "taylor") is None
    for method, facts in adapter.methods.items():
        reason = adapter.unsupported(scene, method)
        if reason is None and facts.control == "dt":
            adapter.build(scene, method, scene.sample_interval_s).close()
        assert reason is None or reason.isprintable()


def test_the_reference_asks_a_function_where_it_can(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of its methods those refuse whose loads are needed within compiled code, each by its reason."""
    (tmp_path / "asked_by_the_reference.py").write_text("def f(t, x, r, v, w):\n    return -v, -w\n")
    monkeypatch.chdir(tmp_path)
    text = LINKED + '[[forcing]]\nkind = "callable"\nfunction = "asked_by_the_reference:f"\n'
    scene = parse_scenario(text, "linked.toml", allow_code=True).scene
    adapter: Adapter = Reference()
    reasons = {name: adapter.unsupported(scene, name) for name in adapter.methods}
    compiled = [m.name for m in INTEGRATORS.values() if m.lasting == "every stage" and m.tableau is None]
    refused = {"exact": "closed form", "taylor": "series", **dict.fromkeys(compiled, "compiled")}
    assert {name for name, reason in reasons.items() if reason} == set(refused)
    assert all(words in (reasons[name] or "") for name, words in refused.items())
