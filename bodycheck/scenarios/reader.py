"""Read a TOML file, with its [[sweep]] table, into its scenarios; report all errors of the file at once."""

from __future__ import annotations

import copy
import re
from collections import Counter
from collections.abc import Callable, Iterator
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar

from pydantic import Field, PlainValidator, StrictStr, ValidationError, field_validator

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import count, nearest
from bodycheck._util.untrusted import parse_toml, read_text
from bodycheck.reference_impl.trees.joint_kinds import joint_kinds
from bodycheck.scenarios.body import BODY_FORMS
from bodycheck.scenarios.fields import TomlTable, finite_numbers
from bodycheck.scenarios.forcings import FORCING_KINDS, JOINT_FORCINGS
from bodycheck.scenarios.model import Scenario, ScenarioTable

if TYPE_CHECKING:
    from bodycheck.scenarios.tree_model import TreeScenario

_FORCINGS = {*FORCING_KINDS, *JOINT_FORCINGS}
_STEP = re.compile(r"(?:^|\.)([A-Za-z_]\w*)|\[(\d+)\]")


def _number_or_text(value: Any) -> float | str:
    return value if isinstance(value, str) else float(finite_numbers(value, "a number or a string", ()))


_Value: TypeAlias = Annotated[float | str, PlainValidator(_number_or_text)]


class Sweep(TomlTable):
    """[[sweep]]: a key, as a path in the file, and its values."""

    key: StrictStr
    values: Annotated[tuple[_Value, ...], Field(min_length=1)]

    @field_validator("key")
    @classmethod
    def _a_path(cls, value: str) -> str:
        if "".join(match.group() for match in _STEP.finditer(value)) != value or not value:
            raise ValueError("must be a path in the file, like initial.omega_body_rad_s[0]")
        if value.partition(".")[0] in ("name", "sweep"):
            raise ValueError(f"cannot be {value!r}: the children get their names from the values")
        return value

    @field_validator("values")
    @classmethod
    def _different(cls, value: tuple[float | str, ...]) -> tuple[float | str, ...]:
        if len({label(one) for one in value}) < len(value):
            raise ValueError("contains a value twice")
        return value


class Family(TomlTable):
    """The part of a file that makes it a family."""

    sweep: Annotated[tuple[Sweep, ...], Field(min_length=1, max_length=1)]


def label(value: float | str) -> str:
    """Return a value as written in the name of its child."""
    return value if isinstance(value, str) else repr(value)


def children(data: dict[str, Any], sweep: Sweep) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield for each value its label and the file's data with that value.

    Raises ValueError if the key's path does not exist in the file.
    """
    for value in sweep.values:
        child = copy.deepcopy(data)
        _put(child, sweep.key, value)
        if isinstance(data.get("name"), str):
            child["name"] = f"{data['name']}/{label(value)}"
        yield label(value), child


def _put(data: Any, key: str, value: float | str) -> None:
    """data.key = value; the last part of the path may be new, the rest must exist."""
    *path, last = [name or int(index) for name, index in _STEP.findall(key)]
    place = data
    for step in path:
        if not _has(place, step):
            raise ValueError(f"{key!r} is not a path in this file: there is no {step!r}")
        place = place[step]
    if not isinstance(place, dict if isinstance(last, str) else list) or (
        isinstance(last, int) and not _has(place, last)
    ):
        raise ValueError(f"{key!r} is not a path in this file: there is no place for {last!r}")
    was = place[last] if _has(place, last) else None
    is_whole = isinstance(was, int) and isinstance(value, float) and value.is_integer()
    place[last] = int(value) if is_whole else value  # some keys need whole numbers


def _has(place: Any, step: int | str) -> bool:
    if isinstance(step, int):
        return isinstance(place, list) and step < len(place)
    return isinstance(place, dict) and step in place


AnyScenario: TypeAlias = "Scenario | TreeScenario"
"""A scenario of one body or of a tree."""

Members: TypeAlias = dict[str | None, Scenario]
"""The scenarios of a file: None -> the only one, or label of the value -> child of a family."""

AnyMembers: TypeAlias = "dict[str | None, AnyScenario]"
"""The same, with trees."""


def read_members(path: Path, *, allow_code: bool = False) -> Members:
    """Read the scenarios of a file; allow_code: it may name functions, whose code runs.

    Raises InputError with one line per error: the file, the path of the key in it, what is wrong and what
    would be right.
    """
    return parse_members(read_text(path), where=str(path), folder=path.parent, allow_code=allow_code)


def parse_members(text: str, where: str, folder: Traversable, *, allow_code: bool = False) -> Members:
    """Read TOML text; `where` names it in messages, mesh files are relative to `folder`.

    A tree of one free or pivoted body gives that body's scenario. Raises InputError as read_members does, and
    for any other tree.
    """
    return _members(text, where, folder, _single, allow_code=allow_code)


def read_any(path: Path, *, allow_code: bool = False) -> AnyMembers:
    """Read the scenarios of a file as read_members does, or its trees."""
    return parse_any(read_text(path), where=str(path), folder=path.parent, allow_code=allow_code)


def parse_any(text: str, where: str, folder: Traversable, *, allow_code: bool = False) -> AnyMembers:
    """Read TOML text as parse_members does; a tree of several bodies is read as one."""
    return _members(text, where, folder, _any, allow_code=allow_code)


TreeMembers: TypeAlias = "dict[str | None, TreeScenario]"
"""The same as Members, of a file with trees."""


def read_trees(path: Path) -> TreeMembers:
    """Read the trees of a file. Raises InputError as read_members does, and for a file with one [body]."""
    return parse_trees(read_text(path), where=str(path), folder=path.parent)


def parse_trees(text: str, where: str, folder: Traversable) -> TreeMembers:
    """Read TOML text of a tree; `where` names it in messages, mesh files are relative to `folder`.

    Raises InputError as read_trees does.
    """
    return _members(text, where, folder, _tree)


_S = TypeVar("_S", bound="ScenarioTable")
_Validate: TypeAlias = Callable[[dict[str, Any], dict[str, Any]], _S]


def _members(
    text: str, where: str, folder: Traversable, validated: _Validate[_S], *, allow_code: bool = False
) -> dict[str | None, _S]:
    context = {"folder": folder, "allow_code": allow_code, "file": Path(where)}
    try:
        data = parse_toml(text, where)
        if "sweep" in data:
            return _family(data, where, context, validated)
        return {None: validated(data, context)}
    except RecursionError:
        raise InputError(f"{where}: is nested too deeply") from None
    except ValidationError as error:
        raise InputError("\n".join(f"{where}: {line}" for line in fault_lines(error))) from None


def _any(data: dict[str, Any], context: dict[str, Any]) -> AnyScenario:
    """Return the scenario of one body, or the tree that is none."""
    if not isinstance(data.get("body"), list):
        return Scenario.model_validate(data, context=context)
    from bodycheck.scenarios.tree_model import as_single_body  # makes the tables of every kind of joint

    tree = _tree(data, context)
    single = as_single_body(data, tree)
    return tree if single is None else Scenario.model_validate(single, context=context)


def _single(data: dict[str, Any], context: dict[str, Any]) -> Scenario:
    """Return the scenario of one body. Raises InputError for a tree that is none."""
    found = _any(data, context)
    if isinstance(found, Scenario):
        return found
    hint = "'bodycheck run' and 'bodycheck dynamics' compare engines with it"
    raise InputError(f"{context['file']}: is a tree of bodies, unsupported by this command; {hint}")


def _tree(data: dict[str, Any], context: dict[str, Any]) -> TreeScenario:
    """Return the tree. Raises InputError for a file with one [body]."""
    if isinstance(data.get("body"), dict):
        raise InputError(f"{context['file']}: has one [body]; a tree of bodies has [[body]] tables")
    from bodycheck.scenarios.tree_model import TreeScenario  # makes the tables of every kind of joint

    return TreeScenario.model_validate(data, context=context)


def _family(
    data: dict[str, Any], where: str, context: dict[str, Any], validated: _Validate[_S]
) -> dict[str | None, _S]:
    """Return the children; report an error that all of them share only once, for the file."""
    (sweep,) = Family.model_validate({"sweep": data.pop("sweep")}).sweep
    try:
        files = list(children(data, sweep))
    except ValueError as error:
        raise InputError(f"{where}: sweep[0].key: {error}") from None
    found: dict[str | None, _S] = {}
    faults: dict[str, list[str]] = {}
    for label, child in files:
        try:
            found[label] = validated(child, {**context, "label": label})
        except ValidationError as error:
            faults[label] = fault_lines(error)
    if faults:
        counts = Counter(line for lines in faults.values() for line in lines)
        shared = [f"{where}: {line}" for line, count in counts.items() if count == len(files)]
        own = [
            f"{where}/{label}: {line}"
            for label, lines in faults.items()
            for line in lines
            if counts[line] < len(files)
        ]
        raise InputError("\n".join([*shared, *own]))
    return found


def fault_lines(error: ValidationError) -> list[str]:
    """Return one line per error: the path of the key in the file, what is wrong and what would be right."""
    faults = error.errors(include_url=False)
    places = [fault["loc"] for fault in faults]
    return [_line(fault) for fault in faults if not _is_consequence(fault, places)]


def _is_consequence(fault: Any, places: list[tuple[int | str, ...]]) -> bool:
    """Return whether a list is too short only because of invalid members, which have errors of their own."""
    own = fault["loc"]
    return fault["type"] == "too_short" and any(own == place[: len(own)] != place for place in places)


def _line(fault: Any) -> str:
    """Return 'path.in.file[0]: what is wrong (it is ...)'."""
    path = _path(fault["loc"])
    match fault["type"]:
        case "missing":
            return f"{path}: is required"
        case "extra_forbidden":
            table = next((form for form in BODY_FORMS if form in fault["loc"]), "this table")
            if fault["loc"][-3:-2] == ("joint",):
                table = f"a joint of kind {fault['loc'][-2]!r}"
            return f"{path}: is not a key of {table}{_similar_key(str(fault['loc'][-1]))}"
        case "model_type":
            return f"{path}: should be a table (it is {fault['input']!r:.60})"
        case "tuple_type":
            return f"{path}: should be a list (it is {fault['input']!r:.60})"
        case "too_short":
            items = count(fault["ctx"]["min_length"], "item")
            return f"{path}: must have at least {items}, not {fault['ctx']['actual_length']}"
        case "too_long":
            items = count(fault["ctx"]["max_length"], "item")
            return f"{path}: must have at most {items}, not {fault['ctx']['actual_length']}"
        case "value_error":
            return f"{path}: {fault['ctx']['error']}"
        case _:
            message = re.sub("^(Input|String) should", "should", fault["msg"])
            text = repr(fault["input"])
            return f"{path}: {message}" + (f" (it is {text})" if len(text) <= 60 else "")


def _similar_key(typed: str) -> str:
    """Return "; did you mean KEY?" for a key that resembles what was typed, or begins with it."""
    known = {key for table in _tables(TomlTable) for key in table.model_fields}
    if typed in known:  # of another table
        return ""
    longer = sorted((key for key in known if key.startswith(f"{typed}_")), key=len)
    key = nearest(typed, sorted(known)) or next(iter(longer), None)
    return f"; did you mean {key}?" if key else ""


def _tables(table: type[TomlTable]) -> Iterator[type[TomlTable]]:
    for own in table.__subclasses__():
        yield own
        yield from _tables(own)


def _path(location: tuple[int | str, ...]) -> str:
    """Return the path of a key: forcing[0].value_n_m[1]."""
    path = ""
    for before, part in zip((None, *location), location, strict=False):
        if part in BODY_FORMS or (isinstance(before, int) and part in _FORCINGS):
            continue
        if before == "joint" and part in joint_kinds():
            continue  # pydantic's name of the union's member, not a key of the file
        path += f"[{part}]" if isinstance(part, int) else f".{part}"
    return path.lstrip(".")
