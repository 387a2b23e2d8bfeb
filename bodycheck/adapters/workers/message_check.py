"""The one typed check of what a worker says: built-in engines, other programs, and what of it was stored.

Numbers are finite, texts and lists bounded, arrays of a shape that is known before they are decoded. What
fails becomes the outcome of its case, or makes its engine unavailable.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from bodycheck._util.untrusted import escaped, printable
from bodycheck.adapters.contract import BuildKind, Control

_MOST_METHODS = 1000
_MOST_PARTS = 10_000  # of a build
_MOST_FAULTS = 3
_LONGEST_S = 1e9  # thirty years of processor time, or a step of as many
_MOST_STEPS = 10**15


def _on_one_line(text: str) -> str:
    if not text.isprintable():
        raise ValueError("should be one line of printable text")
    return text


Name: TypeAlias = Annotated[
    str, Field(strict=True, min_length=1, max_length=200), AfterValidator(_on_one_line)
]
Text: TypeAlias = Annotated[str, Field(strict=True, max_length=10_000), AfterValidator(escaped)]
Number: TypeAlias = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Seconds: TypeAlias = Annotated[Number, Field(ge=0.0, le=_LONGEST_S)]
Step: TypeAlias = Annotated[Number, Field(gt=0.0, le=_LONGEST_S)]
Tolerance: TypeAlias = Annotated[Number, Field(gt=0.0, lt=1.0)]


class ProtocolError(ValueError):
    """A message that does not follow the protocol."""


class _Message(BaseModel):
    """A message may have more keys than its own, which nothing reads."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class MethodMessage(BaseModel):
    """What an engine says of one method: the fields of contract.Method."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Name
    formula: Text
    order: Annotated[int, Field(strict=True, ge=0, le=1000)] | None
    evaluations: Annotated[int, Field(strict=True, ge=0, le=10**6)] | None
    torque: Text
    keeps: Text
    source: Text
    control: Control = "dt"
    changed_defaults: Annotated[list[Text], Field(max_length=1000)] = []
    tolerances: Annotated[list[Tolerance], Field(max_length=1000)] = []
    lasting: Text = "held over the step"


class _Limits(_Message):
    message_bytes: Annotated[int, Field(strict=True, ge=1, le=10**18)]


class AnnouncementMessage(_Message):
    """A worker's first message; keys of later versions are let pass."""

    engine: Name
    version: Name
    methods: Annotated[list[MethodMessage], Field(min_length=1, max_length=_MOST_METHODS)]
    limits: _Limits
    build: Annotated[str, Field(strict=True, max_length=200), AfterValidator(escaped)] = ""
    kind: BuildKind = "plug-in"
    loaded: Annotated[dict[Text, Text], Field(max_length=_MOST_PARTS)] = {}


class ArrayMessage(BaseModel):
    """An array before it is decoded; its base64 is checked by its length and as it is decoded."""

    model_config = ConfigDict(extra="forbid")

    shape: Annotated[list[Annotated[int, Field(strict=True, ge=0, le=10**9)]], Field(max_length=3)]
    base64: Annotated[str, Field(strict=True)]


_Arrays: TypeAlias = Annotated[dict[Name, ArrayMessage], Field(max_length=20)]


class ReadBackMessage(BaseModel):
    """What an engine says it was given; a number that is not finite is null."""

    model_config = ConfigDict(extra="forbid")

    mass: Number | None
    inertia: ArrayMessage
    dt_s: Number | None
    gravity: ArrayMessage
    state: _Arrays


class AnswerMessage(_Message):
    """The answer to a case that ended well."""

    trajectory: _Arrays
    read_back: ReadBackMessage
    stepping: Literal["native", "python"]
    steps: Annotated[int, Field(strict=True, ge=0, le=_MOST_STEPS)] | None


class LapMessage(_Message):
    """The answer to `lap`."""

    cpu_s: Seconds


class StableStepMessage(_Message):
    """The answer to a search that ended well: at least one of the two steps."""

    stable_s: Step | None
    unstable_s: Step | None
    reason: Text = ""


_Checked = TypeVar("_Checked", bound=BaseModel)


def checked(model: type[_Checked], message: Any, what: str) -> _Checked:
    """Return a message as its model has it; ProtocolError, which says what is wrong with it, else."""
    try:
        return model.model_validate(message)
    except ValidationError as error:
        raise ProtocolError(f"{what}: {faults(error)}") from None


def faults(error: ValidationError) -> str:
    """Return what is wrong, with its path in the message: at most three faults, in one line."""
    lines = []
    for fault in error.errors(include_url=False, include_input=False)[:_MOST_FAULTS]:
        path = ".".join(str(part) for part in fault["loc"]) or "it"
        lines.append(printable(f"{path}: {fault['msg'].replace('Input should', 'should')}", 150))
    return "; ".join(lines)


def text_of(message: Mapping[str, Any], key: str) -> str:
    """Return the text under a key of a message that is shown; empty where it is none."""
    value = message.get(key)
    return value if isinstance(value, str) else ""
