"""Pinned versions of engines in pip's notation: NAME==VERSION."""

from __future__ import annotations

import re
from dataclasses import dataclass

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import suggestion
from bodycheck.adapters.programs import is_command, program_of
from bodycheck.adapters.registry import distribution_of, engine_names

_VERSION = re.compile(r"\d+(\.\d+)*(\.?(a|b|rc|post|dev)\d+)*")


@dataclass(frozen=True)
class Pin:
    """An engine and the requested version; None for the newest that its adapter accepts."""

    engine: str
    version: str | None

    @property
    def name(self) -> str:
        """The name of the engine in a run: NAME==VERSION, or NAME."""
        return self.engine if self.version is None else f"{self.engine}=={self.version}"


def pin_of(name: str) -> Pin | None:
    """Return the pin of NAME==VERSION; None for an installed engine, NAME, and for a program."""
    engine, sign, version = name.partition("==")
    return Pin(engine, version) if sign and not is_command(name) else None


def is_version(text: str) -> bool:
    """Return whether this is a single version, not a pattern or a range."""
    return _VERSION.fullmatch(text) is not None


def engine_fault(name: str) -> str | None:
    """Return what is wrong with the name of an engine, NAME or NAME==VERSION; None if it is valid."""
    pin = pin_of(name)
    engine = name if pin is None else pin.engine
    if engine not in engine_names():
        try:
            if program_of(name) is not None:
                return None
        except InputError as error:
            return str(error)
        named, _, version = engine.partition("=")
        if named in engine_names():
            return f"{name}: invalid version pin (expected NAME==VERSION, like {named}=={version or '4.0.0'})"
        return f"unknown engine {engine!r}{suggestion(engine, engine_names())}"
    if pin is None:
        return None
    if pin.version is None or not is_version(pin.version):
        return f"{name}: {pin.version!r} is not a version (expected one release, like {engine}==4.0.0)"
    if distribution_of(engine) is None:
        return f"{name}: {engine} is part of bodycheck and cannot be installed in another version"
    return None
