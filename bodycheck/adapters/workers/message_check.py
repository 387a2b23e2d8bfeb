"""Typed validation of all worker messages: of built-in engines, of other programs, and of stored messages.

Numbers are finite, strings and lists bounded, and the shapes of arrays known before they are decoded. An
invalid message becomes the outcome of its case, or makes its engine unavailable.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError

from bodycheck._util.untrusted import escaped, printable
from bodycheck.adapters.contract import BuildKind, Control, Precision

_MAX_METHODS = 1000
_MAX_PARTS = 10_000  # of a build
_MAX_FAULTS = 3
_LONGEST_S = 1e9  # thirty years, of CPU time or of one step
_MAX_STEPS = 10**15
_MAX_ROWS = 10**6  # of a batch


def _on_one_line(text: str) -> str:
    if not text.isprintable():
        raise ValueError("should be one line of printable text")
    return text


Name: TypeAlias = Annotated[
    str, Field(strict=True, min_length=1, max_length=200), AfterValidator(_on_one_line)
]
_RawText: TypeAlias = Annotated[str, Field(strict=True, max_length=10_000)]
Text: TypeAlias = Annotated[_RawText, AfterValidator(escaped)]
Number: TypeAlias = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Seconds: TypeAlias = Annotated[Number, Field(ge=0.0, le=_LONGEST_S)]
Step: TypeAlias = Annotated[Number, Field(gt=0.0, le=_LONGEST_S)]
Tolerance: TypeAlias = Annotated[Number, Field(gt=0.0, lt=1.0)]


class ProtocolError(ValueError):
    """A message that does not follow the protocol."""


class _Message(BaseModel):
    """A message; additional keys are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class MethodMessage(BaseModel):
    """A method of an announcement: the fields of contract.Method."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Name
    formula: Text
    order: Annotated[int, Field(strict=True, ge=0, le=1000)] | None
    evaluations: Annotated[int, Field(strict=True, ge=0, le=10**6)] | None
    torque: Text
    conserves: Text
    source: Text
    control: Control = "dt"
    changed_defaults: Annotated[list[Text], Field(max_length=1000)] = []
    tolerances: Annotated[list[Tolerance], Field(max_length=1000)] = []
    continuous_loads: Text = "zero-order hold"
    snippet: Text = ""
    precision: Precision = "float64"
    rounding_bias: Annotated[float, Field(strict=True, ge=0.0, le=1000.0)] = 0.0
    only_on_request: Annotated[bool, Field(strict=True)] = False


class _Limits(_Message):
    message_bytes: Annotated[int, Field(strict=True, ge=1, le=10**18)]


class AnnouncementMessage(_Message):
    """A worker's first message; keys of later versions are ignored."""

    engine: Name
    version: Name
    methods: Annotated[list[MethodMessage], Field(min_length=1, max_length=_MAX_METHODS)]
    limits: _Limits
    build: Annotated[str, Field(strict=True, max_length=200), AfterValidator(escaped)] = ""
    kind: BuildKind = "plug-in"
    loaded: Annotated[dict[_RawText, _RawText], Field(max_length=_MAX_PARTS), AfterValidator(escaped)] = {}


class ArrayMessage(BaseModel):
    """An encoded array; decoding checks the length and the content of its base64."""

    model_config = ConfigDict(extra="forbid")

    shape: Annotated[list[Annotated[int, Field(strict=True, ge=0, le=10**9)]], Field(max_length=3)]
    base64: Annotated[str, Field(strict=True)]


_Arrays: TypeAlias = Annotated[dict[Name, ArrayMessage], Field(max_length=20)]


class ReadBackMessage(BaseModel):
    """The model as read from the engine; a number that is not finite is null."""

    model_config = ConfigDict(extra="forbid")

    mass: Number | None
    inertia: ArrayMessage
    dt_s: Number | None
    gravity: ArrayMessage
    state: _Arrays


class AnswerMessage(_Message):
    """The answer to `record` for a case with the outcome ok."""

    trajectory: _Arrays
    read_back: ReadBackMessage
    stepping: Literal["native", "python"]
    steps: Annotated[int, Field(strict=True, ge=0, le=_MAX_STEPS)] | None


class BatchAnswerMessage(_Message):
    """The answer to `batch` with the outcome ok: an ending and a text for each body."""

    quaternion: ArrayMessage
    omega_body: ArrayMessage
    endings: Annotated[
        list[Literal["ok", "unsupported", "failed", "timeout", "invalid"]], Field(max_length=_MAX_ROWS)
    ]
    messages: Annotated[list[Text], Field(max_length=_MAX_ROWS)]


class LapMessage(_Message):
    """The answer to `lap`."""

    cpu_s: Seconds


class StableStepMessage(_Message):
    """The answer to `stable-step` with the outcome ok: at least one of the two steps."""

    stable_s: Step | None
    unstable_s: Step | None
    reason: Text = ""


_Checked = TypeVar("_Checked", bound=BaseModel)


def checked(model: type[_Checked], message: Any, what: str) -> _Checked:
    """Validate a message; raises ProtocolError, which says what is wrong, if it is invalid."""
    try:
        return model.model_validate(message)
    except ValidationError as error:
        raise ProtocolError(f"{what}: {faults(error)}") from None


def faults(error: ValidationError) -> str:
    """Return at most three errors with their paths in the message, in one line."""
    lines = []
    for fault in error.errors(include_url=False, include_input=False)[:_MAX_FAULTS]:
        path = ".".join(str(part) for part in fault["loc"]) or "it"
        lines.append(printable(f"{path}: {fault['msg'].replace('Input should', 'should')}", 150))
    return "; ".join(lines)


def text_of(message: Mapping[str, Any], key: str) -> str:
    """Return the string under a key of a message; empty if there is none."""
    value = message.get(key)
    return value if isinstance(value, str) else ""
