"""A finding: what an engine does otherwise than expected, with all that is needed to see it and to refute it.

The files of census/findings/ hold them, one per engine, one table per finding.
"""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path

from bodycheck._util.errors import InputError

HERE = Path(__file__).parent
DRIVERS, FINDINGS, INPUTS = (HERE / name for name in ("drivers", "findings", "inputs"))

KINDS = {
    "defect": "the code computes something else than it documents, or something impossible",
    "omission": "an importer drops what a file states, without an error",
    "default": "the default changes the motion or the model, and another setting is correct",
    "property": "the engine works as designed, unlike the equations of motion, or another of its releases",
}
NOT_FOUND = "none found"
WITHIN = 0.02
"""Relative difference up to which a figure is reproduced."""

Figure = float | str


@dataclass(frozen=True)
class Finding:
    """One finding. Commands run in a folder with the files of `inputs`."""

    name: str
    engine: str
    title: str
    kind: str
    releases: str
    """In which releases of the engine, in words."""
    size: str
    """How large, in words."""
    expected: str
    """What was expected, and why."""
    found: str
    upstream: str
    """Address of the public issue or of the documentation, or NOT_FOUND."""
    environment: str
    """The engine whose environment runs the driver, as NAME==VERSION; NAME if the machine provides it."""
    packages: tuple[str, ...] = ()
    """Of releases that bodycheck does not run: the packages that the driver needs, in pip's notation."""
    python: str = ""
    """The Python that they need, if it is another one."""
    command: str = ""
    """The first way: a command of bodycheck."""
    figures: Mapping[str, Figure] = field(default_factory=dict)
    """Place in the JSON that the command prints -> number, up to WITHIN, or part of its text."""
    driver: str = ""
    """The second way, MODULE EXPERIMENT of census/drivers: the engine without bodycheck."""
    driver_figures: tuple[float, ...] = ()
    source: str = ""
    """The third way: where the engine's own source shows it."""
    inputs: tuple[str, ...] = ()
    searched: str = ""
    """Where no public issue was found: the words that were searched for in issues and pull requests."""

    def __post_init__(self) -> None:
        """Raise InputError if a field is empty or not of the words that are known."""
        place = f"census/findings/{self.engine}.toml: {self.name}"
        for one in fields(self):
            if one.default is MISSING and one.default_factory is MISSING and not getattr(self, one.name):
                raise InputError(f"{place}: {one.name} is empty")
        for way, figures in (("command", self.figures), ("driver", self.driver_figures)):
            if bool(getattr(self, way)) != bool(figures):
                raise InputError(f"{place}: {way} needs figures, and figures a {way}")
        if bool(self.searched) == self.is_public:
            raise InputError(f"{place}: searched is needed where no public issue was found, and only there")
        if len(self.ways) < 2:
            raise InputError(f"{place}: one way is not enough: command, driver or source is missing")
        if self.kind not in KINDS:
            raise InputError(f"{place}: kind = {self.kind!r} is not one of {', '.join(KINDS)}")
        for name in self.inputs:
            if not (INPUTS / name).is_file():
                raise InputError(f"{place}: there is no file census/inputs/{name}")
        if self.command and shlex.split(self.command)[0] != "bodycheck":
            raise InputError(f"{place}: the command does not begin with bodycheck")

    @property
    def ways(self) -> list[str]:
        """In which independent ways the finding was seen."""
        return [way for way in ("command", "driver", "source") if getattr(self, way)]

    @property
    def is_public(self) -> bool:
        """Whether a public issue or the documentation was found."""
        return self.upstream != NOT_FOUND


def read_findings(folder: Path = FINDINGS) -> dict[str, Finding]:
    """Return all findings by name, in the order of the files.

    Raises InputError, with file and table, for a missing, an empty or an unknown field.
    """
    found: dict[str, Finding] = {}
    for path in sorted(folder.glob("*.toml")):
        for name, table in tomllib.loads(path.read_text(encoding="utf-8")).items():
            for key in ("inputs", "driver_figures", "packages"):
                if key in table:
                    table[key] = tuple(table[key])
            try:
                one = Finding(name=name, engine=path.stem, **table)
            except TypeError as error:
                raise InputError(f"{path}: {name}: {str(error).partition('__init__() ')[2]}") from None
            if name in found:
                raise InputError(f"{path}: {name} is also in {found[name].engine}.toml")
            found[name] = one
    return found


def chosen(findings: Mapping[str, Finding], names: list[str]) -> list[Finding]:
    """Return the findings of these names or engines; all without a name. Raises InputError for others."""
    if unknown := [one for one in names if one not in findings and one not in engines_of(findings)]:
        raise InputError(f"{unknown[0]!r} is neither a finding nor an engine with findings")
    return [one for one in findings.values() if not names or one.name in names or one.engine in names]


def engines_of(findings: Mapping[str, Finding]) -> list[str]:
    """Return the engines that have findings, in alphabetical order."""
    return sorted({one.engine for one in findings.values()})
