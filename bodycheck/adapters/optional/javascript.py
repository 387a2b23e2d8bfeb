"""Engines in JavaScript: separate workers under Node, each with its facts in a JSON file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from bodycheck.adapters.contract import Method

_NODE = Path(__file__).parent / "node"


@dataclass(frozen=True)
class JavaScriptEngine:
    """What is known of an engine without starting it, as the class of a Python adapter states it.

    requires: packages in npm's notation; worker: the program, which Node runs.
    """

    name: str
    distribution: str
    requires: tuple[str, ...]
    methods: Mapping[str, Method]
    worker: Path

    @classmethod
    def of(cls, name: str) -> JavaScriptEngine:
        """Return the engine of node/NAME.json and node/NAME.mjs."""
        facts = json.loads((_NODE / f"{name}.json").read_text(encoding="utf-8"))
        methods = [Method.of(one) for one in facts["methods"]]
        return cls(
            facts["name"],
            facts["distribution"],
            tuple(facts["requires"]),
            {method.name: method for method in methods},
            _NODE / f"{name}.mjs",
        )


RAPIER = JavaScriptEngine.of("rapier")
JOLT = JavaScriptEngine.of("jolt")
CANNON = JavaScriptEngine.of("cannon")
