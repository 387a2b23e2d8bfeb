"""Validate and decode the messages of workers: of built-in engines, of other programs, and stored ones.

Numbers are finite, strings and lists bounded, and the shapes of arrays known before they are decoded. An
invalid message becomes the outcome of its case, or makes its engine unavailable.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Annotated, Any, TypeAlias, TypeVar, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    TypeAdapter,
    ValidationError,
    model_validator,
)

from bodycheck._util.untrusted import FORMULA, escaped, printable
from bodycheck.adapters.batches import BatchAnswer, RowEnding
from bodycheck.adapters.contract import (
    Adapter,
    Build,
    BuildKind,
    Control,
    Engine,
    Method,
    Precision,
    ReadBack,
    Reading,
    Stepping,
    TreeReadBack,
)
from bodycheck.adapters.execution import Answer, Ending, trajectory_of
from bodycheck.adapters.stable_step import StableStep
from bodycheck.adapters.workers.protocol import (
    LARGEST_MESSAGE,
    Message,
    ProtocolError,
    announcement,
    one_line,
    packed,
    text_of,
    unpacked,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trajectory import Trajectory

_MAX_METHODS = 1000
_MAX_PARTS = 10_000  # of a build
_MAX_FAULTS = 3
_LONGEST_S = 1e9  # thirty years, of CPU time or of one step
_MAX_STEPS = 10**15
_MAX_ROWS = 10**6  # of a batch
_STATE_SHAPES: dict[str, tuple[int, ...]] = {
    "position": (3,),
    "velocity": (3,),
    "quaternion": (4,),
    "rotation": (3, 3),
    "omega_world": (3,),
    "omega_body": (3,),
}
_STORED_KEYS = ("trajectory", "read_back", "stepping", "steps", "stable_s", "unstable_s", "reason")
_STORED_TEXTS = ("build", "run")


def _on_one_line(text: str) -> str:
    if not text.isprintable():
        raise ValueError("should be one line of printable text")
    if text.startswith(FORMULA):
        raise ValueError("should not begin with =, +, - or @, which makes it a formula in tables")
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
    trees: Annotated[bool, Field(strict=True)] = False
    loaded: Annotated[dict[_RawText, _RawText], Field(max_length=_MAX_PARTS), AfterValidator(escaped)] = {}


_Finite: TypeAlias = Number | None
_AS_LISTS: TypeAdapter[Any] = TypeAdapter(list[_Finite] | list[list[_Finite]])


def _or_lists(schema: dict[str, Any]) -> None:
    """Let the JSON Schema of an array accept lists, as `_of_lists` does."""
    encoded = dict(schema)
    schema.clear()
    schema["anyOf"] = [encoded, _AS_LISTS.json_schema()]


class ArrayMessage(BaseModel):
    """An encoded array, or its numbers as lists; decoding checks the length and the content of its base64."""

    model_config = ConfigDict(extra="forbid", json_schema_extra=_or_lists)

    shape: Annotated[list[Annotated[int, Field(strict=True, ge=0, le=10**9)]], Field(max_length=4)]
    base64: Annotated[str, Field(strict=True)]

    @model_validator(mode="before")
    @classmethod
    def _of_lists(cls, value: Any) -> Any:
        """Encode numbers that are listed; null is a number that is not finite."""
        if not isinstance(value, list):
            return value
        try:
            return packed(np.array(_AS_LISTS.validate_python(value), dtype=np.float64))
        except ValueError:  # pydantic's is one, and numpy's for rows of different lengths
            raise ValueError("should be a list of numbers, or of rows of as many numbers each") from None


_Arrays: TypeAlias = Annotated[dict[Name, ArrayMessage], Field(max_length=20)]


class ReadBackMessage(BaseModel):
    """The model as read from the engine; a number that is not finite is null."""

    model_config = ConfigDict(extra="forbid")

    mass: Number | None
    inertia: ArrayMessage
    dt_s: Number | None
    gravity: ArrayMessage
    state: _Arrays


class TreeReadBackMessage(BaseModel):
    """A tree as read from the engine."""

    model_config = ConfigDict(extra="forbid")

    dt_s: Number | None
    tree: _Arrays


class AnswerMessage(_Message):
    """The answer to `record` for a case with the outcome ok."""

    trajectory: Annotated[
        Annotated[_Arrays, Tag("arrays")] | Annotated[list[_Arrays], Tag("states")],
        Discriminator(lambda value: "states" if isinstance(value, list) else "arrays"),
    ]
    read_back: Annotated[
        Annotated[ReadBackMessage, Tag("body")] | Annotated[TreeReadBackMessage, Tag("tree")],
        Discriminator(lambda value: "tree" if isinstance(value, dict) and "tree" in value else "body"),
    ]
    stepping: Stepping = "native"
    steps: Annotated[int, Field(strict=True, ge=0, le=_MAX_STEPS)] | None = None


class BatchAnswerMessage(_Message):
    """The answer to `batch` with the outcome ok: an ending and a text for each body."""

    quaternion: ArrayMessage
    omega_body: ArrayMessage
    endings: Annotated[list[RowEnding], Field(max_length=_MAX_ROWS)]
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
        lines.append(
            printable(
                f"{path}: {fault['msg'].replace('Input should', 'should').removeprefix('Value error, ')}", 150
            )
        )
    return "; ".join(lines)


def _unpacked_as(value: ArrayMessage, name: str, *shape: int) -> Array:
    """Decode an array; raises ProtocolError if it does not have this shape."""
    if tuple(value.shape) != shape:
        raise ProtocolError(f"{name} has the shape {value.shape}, not {list(shape)}")
    return unpacked(vars(value))


def engine_of(message: Message) -> tuple[Engine, int]:
    """Return the engine of an announcement, and the maximum bytes of a request that its worker accepts.

    Raises ProtocolError if the announcement is invalid.
    """
    parsed = checked(AnnouncementMessage, message, "invalid announcement")
    if repeated := [
        name for name, times in Counter(method.name for method in parsed.methods).items() if times > 1
    ]:
        raise ProtocolError(f"invalid announcement: the method {repeated[0]} is named twice")
    methods = {method.name: Method.of(method.model_dump()) for method in parsed.methods}
    build = Build(parsed.build, parsed.kind, {name: one_line(text) for name, text in parsed.loaded.items()})
    max_bytes = min(parsed.limits.message_bytes, LARGEST_MESSAGE)
    return Engine(parsed.engine, parsed.version, methods, build, moves_trees=parsed.trees), max_bytes


def check_engine(adapter: Adapter) -> None:
    """Raise ProtocolError if an adapter's attributes would make an invalid announcement."""
    try:
        facts = announcement(adapter, Build())
    except (TypeError, AttributeError) as error:
        raise ProtocolError(f"invalid methods of an adapter: {error}") from None
    checked(AnnouncementMessage, facts, "invalid adapter")


def _ending_of(message: Message, what: str) -> tuple[Ending, str]:
    """Return the outcome and the text of a message; raises ProtocolError if the outcome is unknown."""
    outcome: Any = message.get("outcome")
    if outcome not in get_args(Ending):
        raise ProtocolError(f"{what} whose outcome is {outcome!r:.80}")
    return outcome, one_line(text_of(message, "message"))


def answer_of(message: Message, t_s: Array) -> Answer:
    """Return the answer to a case that is sampled at t_s (n,).

    Raises ProtocolError or ValueError, which say what is wrong, if the message is not an answer to that case.
    """
    outcome, text = _ending_of(message, "an answer")
    if outcome != "ok":
        return Answer(outcome, text)
    parsed = checked(AnswerMessage, message, "invalid answer")
    try:
        trajectory = _trajectory(parsed.trajectory, t_s)
    except TypeError as error:
        raise ProtocolError(f"incomplete answer: {error}") from None
    if not np.array_equal(trajectory.t_s, t_s):
        raise ProtocolError("a trajectory that is not at the scene's samples")
    return Answer("ok", text, trajectory, _read_back(parsed.read_back), parsed.stepping, parsed.steps)


def _trajectory(value: _Arrays | list[_Arrays], t_s: Array) -> Trajectory:
    """Return the trajectory of arrays over time, or of one state per sample."""
    if isinstance(value, dict):
        return Trajectory(**{name: unpacked(vars(array)) for name, array in value.items()})
    if len(value) != len(t_s):
        raise ProtocolError(f"a trajectory of {len(value)} states, not {len(t_s)}")
    for index, state in enumerate(value):
        if differing := state.keys() ^ value[0].keys():
            raise ProtocolError(f"{min(differing)} is not in every state, see states 0 and {index}")
    return trajectory_of(t_s, [_reading(state) for state in value])


def batch_answer_of(message: Message, rows: int, samples: int) -> BatchAnswer:
    """Return the answer to a batch of so many bodies and samples.

    Raises ProtocolError if the message is not one.
    """
    parsed = checked(BatchAnswerMessage, message, "invalid answer to a batch")
    if len(parsed.endings) != rows or len(parsed.messages) != rows:
        raise ProtocolError(f"an answer with {len(parsed.endings)} endings, not {rows}")
    return BatchAnswer(
        _unpacked_as(parsed.quaternion, "quaternion", rows, samples, 4),
        _unpacked_as(parsed.omega_body, "omega_body", rows, samples, 3),
        tuple(parsed.endings),
        tuple(one_line(text) for text in parsed.messages),
    )


def stored_part(message: Message, answer: Answer | StableStep) -> Message:
    """Return the part of a message that is stored: the checked keys, and nothing else."""
    checked_keys = _STORED_KEYS if answer.outcome == "ok" else ()
    texts = {name: message[name] for name in _STORED_TEXTS if isinstance(message.get(name), str)}
    found = {name: message[name] for name in checked_keys if name in message}
    return {"outcome": answer.outcome, "message": answer.message, **texts, **found}


def read_back_of(read_back: Message) -> ReadBack | TreeReadBack:
    """Return the model that was read back.

    Raises ProtocolError if the message is invalid.
    """
    of_tree = "tree" in read_back
    return _read_back(
        checked(TreeReadBackMessage if of_tree else ReadBackMessage, read_back, "invalid read-back")
    )


def _read_back(read_back: BaseModel) -> ReadBack | TreeReadBack:
    if isinstance(read_back, TreeReadBackMessage):
        numbers = {name: unpacked(vars(array)) for name, array in read_back.tree.items()}
        return TreeReadBack(read_back.dt_s, numbers)
    assert isinstance(read_back, ReadBackMessage)
    return ReadBack(
        mass=math.nan if read_back.mass is None else read_back.mass,
        inertia=_unpacked_as(read_back.inertia, "inertia", 3, 3),
        dt_s=read_back.dt_s,
        gravity=_unpacked_as(read_back.gravity, "gravity", 3),
        state=_reading(read_back.state),
    )


def _reading(arrays: _Arrays) -> Reading:
    """Return a state; raises ProtocolError for an unknown or a missing quantity."""
    if unknown := arrays.keys() - _STATE_SHAPES.keys():
        raise ProtocolError(f"unknown quantity {min(unknown)} of a state (known: {', '.join(_STATE_SHAPES)})")
    state: Any = {name: _unpacked_as(array, name, *_STATE_SHAPES[name]) for name, array in arrays.items()}
    if missing := [name for name in ("position", "velocity") if name not in state]:
        raise ProtocolError(f"a state without {missing[0]}")
    return Reading(**state)


def lap_of(message: Message) -> float:
    """Return the CPU time in s of an answer to `lap`.

    Raises ProtocolError if there is none.
    """
    return checked(LapMessage, message, "invalid lap").cpu_s


def stable_step_of(message: Message) -> StableStep:
    """Return the result of a search.

    Raises ProtocolError if the message is invalid.
    """
    outcome, text = _ending_of(message, "a search")
    if outcome != "ok":
        return StableStep(outcome, text)
    parsed = checked(StableStepMessage, message, "invalid search result")
    steps = [step for step in (parsed.stable_s, parsed.unstable_s) if step is not None]
    if not steps:
        raise ProtocolError("a search result with neither a stable nor an unstable step")
    if steps[0] > steps[-1]:
        raise ProtocolError(f"a stable step of {steps[0]!r} above the unstable step of {steps[-1]!r}")
    return StableStep("ok", text, parsed.stable_s, parsed.unstable_s, one_line(parsed.reason))
