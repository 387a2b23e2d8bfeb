"""The worker's request `gradients`: a case, and the derivatives of its end as the engine computes them."""

from __future__ import annotations

from typing import Any, cast

from bodycheck.adapters.contract import Adapter, Setting
from bodycheck.adapters.execution import Case
from bodycheck.adapters.gradients import PARAMETERS, Gradients
from bodycheck.adapters.tree_contract import UnreportedError
from bodycheck.adapters.workers import case_messages, protocol
from bodycheck.adapters.workers.protocol import Message, ProtocolError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene


def gradients_request(scene: Scene, method: str, dt_s: float) -> Message:
    """Return the request to a worker."""
    return {"do": "gradients", "case": case_messages.case_message(Case(scene, method, Setting(dt_s)))}


def answered_gradients(adapter: Adapter, request: Message) -> Message:
    """Return a worker's answer to a request `gradients`."""
    case = case_messages.case_of(request["case"])
    compute = getattr(adapter, "gradients", None)
    if compute is None:
        return {"outcome": "unsupported", "message": f"the adapter of {adapter.name} gives no derivatives"}
    try:
        found = cast(Gradients, compute(case.scene, case.method, case.setting.dt_s))
    except UnreportedError as error:
        return {"outcome": "unsupported", "message": str(error)}
    return {
        "outcome": "ok",
        "attitude": protocol.packed(found.attitude),
        "omega": protocol.packed(found.omega),
    }


def gradients_of(answer: Message) -> Gradients:
    """Return the derivatives of a worker's answer; raises ProtocolError if it has none."""

    def part(name: str) -> Array:
        found = protocol.unpacked(cast(dict[str, Any], answer.get(name)))
        if found.shape != (3, PARAMETERS):
            raise ProtocolError(f"{name} has the shape {list(found.shape)}, not [3, {PARAMETERS}]")
        return found

    return Gradients(part("attitude"), part("omega"))
