"""An engine in a version of its own, asked for as pip writes it: NAME==VERSION."""

from __future__ import annotations

import re
from dataclasses import dataclass

from bodycheck.adapters.registry import distribution_of, engine_names

_VERSION = re.compile(r"\d+(\.\d+)*(\.?(a|b|rc|post|dev)\d+)*")


@dataclass(frozen=True)
class Pin:
    """An engine and the version in which it is asked for."""

    engine: str
    version: str

    @property
    def name(self) -> str:
        """What the engine in this version is called in a run."""
        return f"{self.engine}=={self.version}"


def pin_of(name: str) -> Pin | None:
    """Return what NAME==VERSION asks for; None for an engine as it is installed."""
    engine, sign, version = name.partition("==")
    return Pin(engine, version) if sign else None


def is_version(text: str) -> bool:
    """Whether this is one version, not a pattern or a range."""
    return _VERSION.fullmatch(text) is not None


def engine_fault(name: str) -> str | None:
    """Say what is wrong with the name of an engine, NAME or NAME==VERSION; None where it is good."""
    pin = pin_of(name)
    engine = name if pin is None else pin.engine
    if engine not in engine_names():
        named, _, version = engine.partition("=")
        if named in engine_names():
            return f"{name}: a version is asked for by two signs: {named}=={version or '4.0.0'}"
        return f"no engine is named {engine!r}; known are {', '.join(engine_names())}"
    if pin is None:
        return None
    if not is_version(pin.version):
        return f"{name}: {pin.version!r} is no version; give one release, like {engine}==4.0.0"
    if distribution_of(engine) is None:
        return f"{name}: {engine} is part of this program and cannot be installed in another version"
    return None
