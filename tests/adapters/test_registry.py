"""Engines are found by name, whether built in or from other packages; a missing one states the reason."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint

import pytest

from bodycheck._util.errors import InputError, UnavailableError
from bodycheck.adapters import registry
from bodycheck.adapters.reference import Reference
from tests.helpers.expected_messages import ExpectedMessage


@pytest.fixture
def plugged_in(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Offer two engines from another package, one of which is broken."""
    group = "bodycheck.adapters"
    points = [
        EntryPoint("other", "bodycheck.adapters.reference:Reference", group),
        EntryPoint("aged", "bodycheck.adapters.reference:NoSuchName", group),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda **_: points)
    registry._plugged_in.cache_clear()
    registry._import.cache_clear()
    yield
    registry._plugged_in.cache_clear()
    registry._import.cache_clear()


@pytest.mark.usefixtures("plugged_in")
def test_engines_of_other_packages_are_found_by_entry_point() -> None:
    """An entry point of the group bodycheck.adapters is an engine like any other."""
    assert {"mujoco", "other", "aged"} <= set(registry.engine_names())
    assert isinstance(registry.get_adapter("other"), Reference)


@pytest.mark.usefixtures("plugged_in")
def test_an_engine_that_lacks_a_requested_part_is_unavailable(expected_message: ExpectedMessage) -> None:
    """A package that does not fit is unavailable with the reason and affects no other engine."""
    with expected_message.raises(UnavailableError):
        registry.get_adapter("aged")


def test_an_unknown_engine_is_refused(expected_message: ExpectedMessage) -> None:
    """The error for an unknown name lists the available names."""
    with expected_message.raises(InputError):
        registry.get_adapter("havok")


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize("engine", ["mujoco", "pybullet", "dart"])
def test_an_engine_is_announced_without_numba(engine: str) -> None:
    """Announcing an engine does not import numba, whose import takes half of the start of a worker."""
    program = (
        "import sys; from bodycheck._util.errors import UnavailableError\n"
        "from bodycheck.adapters.workers import protocol\n"
        "from bodycheck.adapters.workers.build_identity import Loaded\n"
        "from bodycheck.adapters.registry import get_adapter\n"
        "try:\n    adapter = get_adapter(sys.argv[1])\n"
        "except UnavailableError:\n    sys.exit(3)\n"
        "protocol.announcement(adapter, Loaded(adapter).build)\n"
        "sys.exit('numba' in sys.modules)"
    )
    ended = subprocess.run([sys.executable, "-c", program, engine], capture_output=True, check=False)
    if ended.returncode == 3:
        pytest.skip(f"{engine} is not there")
    assert ended.returncode == 0, ended.stderr
