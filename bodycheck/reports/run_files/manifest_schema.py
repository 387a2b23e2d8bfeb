"""The typed check of manifest.json: a run that is stored is data from outside."""

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
_MOST_FAULTS = 3
_Count: TypeAlias = Annotated[int, Field(strict=True, ge=0, le=10**12)]


class _Method(MethodMessage):
    """What an engine said of a method, then; keys of other versions are let pass."""

    model_config = ConfigDict(extra="ignore")


class _Engine(BaseModel):
    """One that ran."""

    version: _Text
    methods: dict[_Text, _Method]


class _Unavailable(BaseModel):
    """Why an engine did not run."""

    unavailable: _Text


def _kind(entry: Any) -> str:
    return "unavailable" if isinstance(entry, dict) and "unavailable" in entry else "ran"


_Entry: TypeAlias = Annotated[
    Annotated[_Engine, Tag("ran")] | Annotated[_Unavailable, Tag("unavailable")], Discriminator(_kind)
]


class _Manifest(BaseModel):
    """What comparing, judging and summing up read of a manifest; other keys are let pass."""

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
    scenarios: dict[_Text, dict[_Text, Any]]
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
    """Return a manifest that has what it must have, as it is; InputError with one line a fault else."""
    try:
        _Manifest.model_validate(manifest)
    except ValidationError as error:
        faults = "; ".join(line.lstrip(": ") for line in fault_lines(error)[:_MOST_FAULTS])
        raise InputError(f"{path}: is no manifest of a run: {faults}") from None
    return dict(manifest)
