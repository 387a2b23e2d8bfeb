"""Validate the types in manifest.json, because a stored run is untrusted data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeAlias

from pydantic import (
    AwareDatetime,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    StrictBool,
    Tag,
    ValidationError,
)

from bodycheck._util.errors import InputError
from bodycheck.adapters.workers.message_check import MethodMessage
from bodycheck.scenarios.reader import fault_lines

_Text: TypeAlias = Annotated[str, Field(strict=True, max_length=100_000)]
_Number: TypeAlias = Annotated[float, Field(strict=True, allow_inf_nan=False)]
_MAX_FAULTS = 3
_Count: TypeAlias = Annotated[int, Field(strict=True, ge=0, le=10**12)]


class _Method(MethodMessage):
    """The facts of a method as the engine announced them; keys of other versions are ignored."""

    model_config = ConfigDict(extra="ignore")


class _Engine(BaseModel):
    """An engine that ran."""

    version: _Text
    methods: dict[_Text, _Method]


class _Unavailable(BaseModel):
    """An engine that did not run, with the reason."""

    unavailable: _Text


class _Load(BaseModel):
    """A load of a scenario."""

    model_config = ConfigDict(extra="allow")

    from_s: _Number | None = None
    until_s: _Number | None = None


class _Body(BaseModel):
    """The body of a scenario."""

    model_config = ConfigDict(extra="allow")

    notes: list[_Text] = []


class _Scenario(BaseModel):
    """A scenario; reading a whole run checks all of it."""

    model_config = ConfigDict(extra="allow")

    duration_s: Annotated[_Number, Field(gt=0.0)]
    samples: Annotated[int, Field(strict=True, ge=2, le=10**9)]
    body: _Body
    forcing: list[_Load] = []


def _kind(entry: Any) -> str:
    return "unavailable" if isinstance(entry, dict) and "unavailable" in entry else "ran"


_Entry: TypeAlias = Annotated[
    Annotated[_Engine, Tag("ran")] | Annotated[_Unavailable, Tag("unavailable")], Discriminator(_kind)
]


class _Manifest(BaseModel):
    """The keys of a manifest that comparison, gates and summaries read; other keys are allowed."""

    model_config = ConfigDict(extra="allow")

    run_id: _Text
    created: AwareDatetime
    bodycheck: _Text
    cpu: _Text
    cores: _Count | None
    system: _Text
    python: _Text
    platform: _Text
    libraries: dict[_Text, _Text]
    engines: dict[_Text, _Entry]
    outcomes: dict[_Text, _Count]
    scenarios: dict[_Text, _Scenario]
    dt_s: list[_Number] | None
    tolerances: list[_Number] | None
    speed: StrictBool
    jobs: _Count | None = None
    timeout_s: _Number | None = None
    speed_core: _Count | None
    speed_noise: _Number | None
    compile_s: _Number | None
    truths_s: _Number | None = None
    motions_s: _Number | None = None
    speeds_s: _Number | None = None
    run_s: _Number | None


def check_manifest(path: Path, manifest: Any) -> dict[str, Any]:
    """Return a valid manifest unchanged; raise InputError with one line that lists the faults otherwise."""
    try:
        _Manifest.model_validate(manifest)
    except ValidationError as error:
        faults = "; ".join(line.lstrip(": ") for line in fault_lines(error)[:_MAX_FAULTS])
        raise InputError(f"{path}: not a manifest of a run: {faults}") from None
    return dict(manifest)
