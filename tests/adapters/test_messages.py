"""The typed check of a worker's messages has every field of the contract."""

from __future__ import annotations

from dataclasses import asdict, fields

import pytest

from bodycheck.adapters.contract import Build, Method, ReadBack
from bodycheck.adapters.registry import get_adapter
from bodycheck.adapters.workers import protocol, received_messages
from bodycheck.adapters.workers.received_messages import MethodMessage, ReadBackMessage


def test_check_knows_every_field_of_the_contract() -> None:
    """A field that exists on one side only would be refused or lost."""
    assert {field.name for field in fields(Method)} == MethodMessage.model_fields.keys()
    assert {field.name for field in fields(ReadBack)} == ReadBackMessage.model_fields.keys()


@pytest.mark.parametrize("name", ["mujoco", "dart", "reference"])
def test_announcement_of_a_built_in_engine_passes_the_check_unchanged(name: str) -> None:
    """The facts of a built-in engine's methods pass the check unchanged."""
    adapter = get_adapter(name)
    received_messages.check_engine(adapter)
    build = Build("c0de", "installed", {"python": "3"})
    message = protocol.announcement(adapter, build)
    engine, accepted = received_messages.engine_of(protocol.message_of(protocol.line_of(message)))
    assert accepted == protocol.LARGEST_MESSAGE
    assert engine.build == build
    assert {name: asdict(method) for name, method in engine.methods.items()} == {
        name: asdict(method) for name, method in adapter.methods.items()
    }
