"""The names of engines: NAME, NAME==VERSION, cmd:COMMAND, each with or without a method.

NAME==VERSION is an engine in a pinned version, in pip's notation. `cmd:COMMAND` is a program in any language,
which speaks the worker protocol (docs/workers.md), and is known by the name that it announces. The file of
the option --engines defines other names of programs:

    [engines.rapier]
    command = ["node", "rapier.mjs"]
    environment = { NODE_OPTIONS = "--max-old-space-size=2048" }
"""

from __future__ import annotations

import re
import shlex
import shutil
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bodycheck._util.code_gate import check_code
from bodycheck._util.errors import InputError
from bodycheck._util.formatting import suggestion
from bodycheck._util.untrusted import parse_toml, read_text
from bodycheck.adapters.registry import (
    distribution_of,
    engine_names,
    program_of,
    register_announced,
    register_program,
    requested_name,
)
from bodycheck.scenarios.reader import fault_lines

_COMMAND, _METHOD = "cmd:", "::"
_VERSION = re.compile(r"\d+(\.\d+)*(\.?(a|b|rc|post|dev)\d+)*")


class Program(BaseModel):
    """A command with its arguments, and variables that are added to its environment."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    command: Annotated[list[Annotated[str, Field(min_length=1)]], Field(min_length=1)]
    environment: dict[str, str] = Field(default_factory=dict)


_SHORT_NAME = r"[A-Za-z0-9_.-]{1,60}"


class ProgramsFile(BaseModel):
    """The file of --engines."""

    model_config = ConfigDict(extra="forbid")

    engines: dict[Annotated[str, Field(pattern=rf"^{_SHORT_NAME}$")], Program]


def admit_file(path: Path, *, allow_code: bool) -> None:
    """Admit the programs of a file under their short names.

    Raises InputError if the file is invalid, or has programs and code is not allowed.
    """
    text = read_text(path)
    try:
        found = ProgramsFile.model_validate(parse_toml(text, str(path))).engines
    except ValidationError as error:
        raise InputError("\n".join(f"{path}: {line}" for line in fault_lines(error))) from None
    if taken := found.keys() & set(engine_names()):
        raise InputError(f"{path}: engines.{min(taken)}: is the name of another engine")
    for name, program in found.items():
        check_code(program.command[0], f"is started as {name}", allow_code=allow_code, file=path)
        register_program(name, program, path)


def admit(names: Iterable[str], *, allow_code: bool, file: Path | None = None) -> None:
    """Admit the programs among the names of engines, cmd:COMMAND[::METHOD]; only admitted ones can start.

    allow_code: whether the user wrote the names, or gave --allow-code. file: the file that has the names.
    Raises InputError for a program that is not allowed, or whose command cannot be split into words.
    """
    for name in names:
        engine = split_method(name)[0]
        if not is_command(engine) or program_of(engine) is not None:
            continue
        check_code(engine, "starts a program", allow_code=allow_code, file=file)
        try:
            words = shlex.split(engine.removeprefix(_COMMAND))
        except ValueError as error:
            raise InputError(f"{engine}: {error}") from None
        if not words:
            raise InputError(f"{engine}: no command (expected one like cmd:./worker)")
        register_program(engine, Program(command=words))


def is_command(engine: str) -> bool:
    """Whether the engine is named by a command line."""
    return engine.startswith(_COMMAND)


def is_program(engine: str) -> bool:
    """Whether the engine is a program, named by a command line or in the file of --engines."""
    return is_command(engine) or program_of(engine) is not None


def announced_names(announced: Mapping[str, str]) -> dict[str, str]:
    """Return cmd:COMMAND -> name for the programs that are from now on known by the name that they announced.

    announced: cmd:COMMAND -> that name. A name that is not short, or that another engine or several programs
    have, stays with the command.
    """
    times, others = Counter(announced.values()), set(engine_names())
    found = {
        command: name
        for command, name in announced.items()
        if re.fullmatch(_SHORT_NAME, name) and times[name] == 1 and name not in others
        if program_of(name) is None or is_command(requested_name(name))
    }
    for command, name in found.items():
        register_announced(name, command)
    return found


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


REFERENCE = "reference"
"""The engine that is not one: bodycheck's own methods, listed after the engines."""


def is_named(names: Collection[str], engine: str, method: str) -> bool:
    """Whether --engine names an engine, or one of its methods; no names are all of them."""
    known = [engine, requested_name(engine)]
    return not names or any(name in names or with_method(name, method) in names for name in known)


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
        program = program_of(name)
        if program is not None:
            exists = shutil.which(program.command[0]) is not None
            return None if exists else f"{name}: no such program: {program.command[0]}"
        if is_command(name):
            return f"{name}: may not be started (name the program on the command line or in a call)"
        named, _, version = engine.partition("=")
        if named in engine_names():
            return f"{name}: invalid version pin (expected NAME==VERSION, like {named}=={version or '4.0.0'})"
        alone = split_method(engine)[0]
        if alone in engine_names():
            return f"{name}: name the engine alone: {alone}"
        return f"unknown engine {engine!r}{suggestion(engine, engine_names())}"
    if pin is None:
        return None
    if pin.version is None or not is_version(pin.version):
        return f"{name}: {pin.version!r} is not a version (expected one release, like {engine}==4.0.0)"
    if distribution_of(engine) is None:
        return f"{name}: {engine} is part of bodycheck and cannot be installed in another version"
    return None
