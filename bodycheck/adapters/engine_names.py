"""The names of engines: NAME, NAME==VERSION, cmd:COMMAND, each with or without a method.

NAME==VERSION is an engine in a pinned version, in pip's notation. `cmd:COMMAND` is a program in any language,
which speaks the worker protocol (docs/workers.md). A shorter name of a program is defined in engines.toml in
the working directory:

    [engines.rapier]
    command = ["node", "rapier.mjs"]
    environment = { NODE_OPTIONS = "--max-old-space-size=2048" }
"""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import suggestion
from bodycheck._util.untrusted import parse_toml, read_text
from bodycheck.adapters.registry import distribution_of, engine_names
from bodycheck.scenarios.reader import fault_lines

PROGRAMS_FILE = Path("engines.toml")
_COMMAND, _METHOD = "cmd:", "::"
_VERSION = re.compile(r"\d+(\.\d+)*(\.?(a|b|rc|post|dev)\d+)*")


class Program(BaseModel):
    """A command with its arguments, and variables that are added to its environment."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    command: Annotated[list[Annotated[str, Field(min_length=1)]], Field(min_length=1)]
    environment: dict[str, str] = Field(default_factory=dict)


class _ProgramsFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    engines: dict[Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]{1,60}$")], Program]


def named_programs() -> Mapping[str, Program]:
    """Return the programs of engines.toml in the working directory, by name; raise InputError if invalid."""
    if not PROGRAMS_FILE.exists():
        return {}
    text = read_text(PROGRAMS_FILE)
    try:
        found = _ProgramsFile.model_validate(parse_toml(text, str(PROGRAMS_FILE))).engines
    except ValidationError as error:
        raise InputError("\n".join(f"{PROGRAMS_FILE}: {line}" for line in fault_lines(error))) from None
    if taken := found.keys() & set(engine_names()):
        raise InputError(f"{PROGRAMS_FILE}: engines.{min(taken)}: is the name of another engine")
    return found


def program_of(engine: str) -> Program | None:
    """Return the program of cmd:COMMAND, or of a name in engines.toml; None for any other engine.

    Raises InputError if the command cannot be split into words, the program does not exist, or engines.toml
    is invalid.
    """
    if not is_command(engine):
        program = None if engine in engine_names() else named_programs().get(engine)
    else:
        try:
            words = shlex.split(engine.removeprefix(_COMMAND))
        except ValueError as error:
            raise InputError(f"{engine}: {error}") from None
        if not words:
            raise InputError(f"{engine}: no command (expected one like cmd:./worker)")
        program = Program(command=words)
    if program is not None and shutil.which(program.command[0]) is None:
        raise InputError(f"{engine}: no such program: {program.command[0]}")
    return program


def is_command(engine: str) -> bool:
    """Whether the engine is named by a command line."""
    return engine.startswith(_COMMAND)


def is_program(engine: str) -> bool:
    """Whether the engine is a program, named by a command line or in engines.toml."""
    return is_command(engine) or (engine not in engine_names() and engine in named_programs())


def split_method(name: str) -> tuple[str, str, str]:
    """Split NAME[==VERSION][:METHOD] or cmd:COMMAND[::METHOD] into engine, separator (or "") and method."""
    if is_command(name):
        engine, mark, method = name.partition(_METHOD)
    else:
        engine, mark, method = name.partition(":")
        engine = "==".join(part.strip() for part in engine.split("=="))
    return engine, mark, method.strip()


def with_method(engine: str, method: str) -> str:
    """Return the name of a method as `--engine` accepts it."""
    return f"{engine}{_METHOD if is_command(engine) else ':'}{method}"


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
