"""The column map of a recording: each quantity as a product of columns, numbers and units.

A map is parsed, never evaluated: `wx_body_rad_s = p_deg_s*deg`. The same keys are used in a TOML file, in
`--map`, and in the built-in maps of `--like`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import names, nearest, suggestion
from bodycheck._util.untrusted import parse_toml, read_text
from bodycheck.reference_impl.arrays import Array
from bodycheck.reports.run_files.trajectory_files import COLUMNS

EARTH_RATE_RAD_S = 7.292115e-5
"""Sidereal rate of the Earth in WGS-84 (NIMA TR8350.2, table 3.1)."""

EULER = ("euler_1_rad", "euler_2_rad", "euler_3_rad")
RODRIGUES = ("rodrigues_x", "rodrigues_y", "rodrigues_z")
MODIFIED_RODRIGUES = ("modified_rodrigues_x", "modified_rodrigues_y", "modified_rodrigues_z")
PLACE = ("longitude_rad", "latitude_rad")
BODY_VELOCITY = ("vx_body_m_s", "vy_body_m_s", "vz_body_m_s")

VECTORS = {
    **COLUMNS,
    "euler": EULER,
    "rodrigues": RODRIGUES,
    "modified_rodrigues": MODIFIED_RODRIGUES,
    "place": PLACE,
    "velocity_body_m_s": BODY_VELOCITY,
}
"""Vector or matrix -> what a map defines of it: whole, or not at all."""

ATTITUDES = ("quaternion", "rotation", "euler", "rodrigues", "modified_rodrigues")
"""The vectors and matrices that state an attitude."""

_KINDS = (
    ({"t_s"}, "a time", (1, 0, 0)),
    ({*EULER, *PLACE}, "an angle", (0, 1, 0)),
    ({"x_m", "y_m", "z_m"}, "a length", (0, 0, 1)),
    ({*COLUMNS["velocity_m_s"], *BODY_VELOCITY}, "a velocity", (-1, 0, 1)),
    ({*COLUMNS["omega_world_rad_s"], *COLUMNS["omega_body_rad_s"]}, "an angular velocity", (-1, 1, 0)),
    (
        {*COLUMNS["quaternion"], *COLUMNS["rotation"], *RODRIGUES, *MODIFIED_RODRIGUES},
        "a pure number",
        (0, 0, 0),
    ),
)
"""What a product can give, its kind, and its powers of s, rad and m."""

KINDS = {target: kind for targets, kind, _ in _KINDS for target in targets}
"""What a product can give -> its kind, in SI units."""

_ARRAYS = {column: array for array, columns in COLUMNS.items() for column in columns}
"""Column -> the array that has it, as in "wx_body_rad_s" -> "omega_body_rad_s"."""

_POWERS = {kind: powers for _, kind, powers in _KINDS}

_ANGLE, _LENGTH, _TIME = (0, 1, 0), (0, 0, 1), (1, 0, 0)
UNITS: dict[str, tuple[float, tuple[int, int, int]]] = {
    "rad": (1.0, _ANGLE),
    "deg": (math.pi / 180.0, _ANGLE),
    "arcmin": (math.pi / 10800.0, _ANGLE),
    "arcsec": (math.pi / 648000.0, _ANGLE),
    "rev": (2.0 * math.pi, _ANGLE),
    "rpm": (math.pi / 30.0, (-1, 1, 0)),
    "m": (1.0, _LENGTH),
    "km": (1e3, _LENGTH),
    "cm": (1e-2, _LENGTH),
    "mm": (1e-3, _LENGTH),
    "ft": (0.3048, _LENGTH),
    "inch": (0.0254, _LENGTH),
    "nmi": (1852.0, _LENGTH),
    "kn": (1852.0 / 3600.0, (-1, 0, 1)),
    "s": (1.0, _TIME),
    "ms": (1e-3, _TIME),
    "us": (1e-6, _TIME),
    "ns": (1e-9, _TIME),
    "min": (60.0, _TIME),
    "h": (3600.0, _TIME),
}
"""Unit -> its size in SI units and its powers of s, rad and m."""

_TOKEN = re.compile(
    r"""\s*(?: (?P<quoted>"[^"]*"|'[^']*')
             | (?P<number>[0-9]*\.?[0-9]+(?:[eE][+-]?[0-9]+)?|[0-9]+\.)(?![\w.])
             | (?P<name>[^\W\d]\w*(?:\.\w+|\[[0-9]+\])*)
             | (?P<sign>[-+*/]) )\s*""",
    re.VERBOSE,
)
_PAIR = re.compile(r"""(?:"[^"]*"|'[^']*'|[^,"'])+""")
_LONGEST_TEXT = 10_000
_PAIR_FORM = "expected pairs like wx_body_rad_s=p_deg_s*deg, or a .toml file"

Raw: TypeAlias = dict[str, Any]
"""Key -> text, number or list of texts, as written in a map."""


@dataclass(frozen=True)
class Product:
    """scale x columns x names, where the file settles whether a name is a unit or a column.

    text: as written. columns: in quotes. names: (name, power) without quotes, power -1 where it divides.
    """

    text: str
    scale: float = 1.0
    columns: tuple[str, ...] = ()
    names: tuple[tuple[str, int], ...] = ()

    def settled(self, target: str, known: Sequence[str]) -> tuple[float, tuple[str, ...]]:
        """Return the factor in SI units and the columns, for a file with known columns.

        Raises InputError for an unknown or ambiguous name, and for units of another kind than the target.
        """
        scale, columns, powers = self.scale, list(self.columns), np.zeros(3, dtype=int)
        known_names, has_unit = set(known), False
        for name, power in self.names:
            if name in UNITS and name in known_names and name not in self.columns:
                raise InputError(
                    f'{target}={self.text}: {name} is a unit and a column; write "{name}" for the column, '
                    "or the unit as a number"
                )
            if name in UNITS:
                size, dimension = UNITS[name]
                scale *= size**power
                if not math.isfinite(scale) or scale == 0.0:
                    raise InputError(f"{target}={self.text}: the factor {scale} is of no use")
                powers += power * np.array(dimension)
                has_unit = True
            elif power < 0:
                raise InputError(f"{target}={self.text}: divides by {name}, which is not a number or a unit")
            else:
                columns.append(name)
        if unknown := next((name for name in columns if name not in known_names), None):
            suggestion = nearest(unknown, [*known, *UNITS])
            instead = (
                f"did you mean {suggestion}?"
                if suggestion
                else f"columns: {names(known)}; units: {', '.join(UNITS)}"
            )
            raise InputError(f"{target}={self.text}: {unknown} is not a column or a unit; {instead}")
        if has_unit and not _is_of_kind(powers, KINDS[target]):
            raise InputError(f"{target}={self.text}: these units do not give {KINDS[target]}")
        return scale, tuple(columns)


def _is_of_kind(powers: Array, kind: str) -> bool:
    """Whether units give a kind: deg alone does for deg/s, because a unit may be left out where it is 1."""
    expected = np.array(_POWERS[kind])
    return bool(np.all((powers == expected) | (powers == 0)))


def parse_product(text: str, where: str) -> Product:
    """Return the product of a text; raises InputError, which names `where`, if it is not one."""
    wrong = InputError(
        f'{where}={text}: expected a column, a number, a unit, or products of them, like "P (deg/s)"*deg'
    )
    if len(text) > _LONGEST_TEXT:
        raise InputError(f"{where}: has a product of more than {_LONGEST_TEXT} characters")
    scale, power, position = 1.0, 1, 0
    columns: list[str] = []
    names: list[tuple[str, int]] = []
    expects_factor = True
    while position < len(text):
        found = _TOKEN.match(text, position)
        if found is None:
            raise wrong
        position, kind, word = found.end(), found.lastgroup, found[found.lastgroup or 0].strip()
        if kind == "sign":
            if expects_factor and word in "+-":
                scale = -scale if word == "-" else scale
            elif not expects_factor and word in "*/":
                power, expects_factor = (1 if word == "*" else -1), True
            else:
                raise wrong
            continue
        if not expects_factor:
            raise wrong
        expects_factor = False
        if kind == "number":
            number = float(word)
            if not math.isfinite(number) or (power < 0 and number == 0.0):
                raise InputError(f"{where}={text}: {word} is not a usable factor")
            scale *= number**power
            if not math.isfinite(scale):
                raise InputError(f"{where}={text}: the factor is not a finite number")
        elif kind == "name":
            names.append((word, power))
        elif power < 0:
            raise InputError(f"{where}={text}: divides by the column {word}")
        else:
            columns.append(word[1:-1])
    if expects_factor:
        raise wrong
    return Product(text.strip(), scale, tuple(columns), tuple(names))


_WORLD = {"N": (1, 0, 0), "S": (-1, 0, 0), "W": (0, 1, 0), "E": (0, -1, 0), "U": (0, 0, 1), "D": (0, 0, -1)}
_BODY = {"F": (1, 0, 0), "B": (-1, 0, 0), "L": (0, 1, 0), "R": (0, -1, 0), "U": (0, 0, 1), "D": (0, 0, -1)}


def _axes(text: Any, key: str) -> Array:
    """Return the matrix (3, 3) that takes components in the file's axes to those in the scenario's.

    text: like "NED to ENU": the directions of x, y and z in the file, then in the scenario.
    """
    letters = _WORLD if key == "world" else _BODY
    example = "NED to ENU" if key == "world" else "FRD to FLU"
    words = text.split() if isinstance(text, str) else ()
    if len(words) != 3 or words[1] != "to":
        raise InputError(f"{key}={text}: expected the axes of the file and of the scenario, like {example}")
    frames = []
    for word in (words[0], words[2]):
        if len(word) != 3 or any(letter not in letters for letter in word):
            raise InputError(f"{key}={text}: {word} is not three of {', '.join(letters)}, like {example}")
        frame = np.array([letters[letter] for letter in word], dtype=np.float64)
        if round(float(np.linalg.det(frame))) != 1:
            raise InputError(f"{key}={text}: {word} is not right-handed")
        frames.append(frame)
    return np.asarray(frames[1] @ frames[0].T)


def _one_of(*allowed: str) -> Any:
    def checked(value: Any, key: str) -> str:
        if value not in allowed:
            raise InputError(f"{key}={value}: should be {' or '.join(allowed)}")
        return str(value)

    return checked


def _sequence(value: Any, key: str) -> str:
    """Return the axes of Euler angles, as in SciPy: ZYX about body axes, zyx about world axes."""
    text = value if isinstance(value, str) else ""
    cased = text.isupper() or text.islower()
    if len(text) != 3 or not cased or set(text.lower()) - set("xyz") or text[1] in (text[0], text[2]):
        raise InputError(
            f"{key}={value}: expected three axes in the order of the angles, like ZYX (yaw, pitch, roll "
            "about the axes of the body) or zyx (about the axes of the world)"
        )
    return text


def _rate(value: Any, key: str) -> float:
    try:
        rate = float(value)
    except (TypeError, ValueError):
        rate = math.nan
    if not math.isfinite(rate) or isinstance(value, bool):
        raise InputError(f"{key}={value}: should be a number")
    return rate


def _text(value: Any, key: str) -> str:
    (text,) = _texts(value if isinstance(value, str) else None, key)
    return text


def _columns(value: Any, key: str) -> tuple[str, ...]:
    """Return the names of columns, of a list or of text with blanks between them."""
    return _texts(value.split() if isinstance(value, str) else value, key)


def _texts(value: Any, key: str) -> tuple[str, ...]:
    texts = value if isinstance(value, list | tuple) else [value]
    if not all(isinstance(text, str) for text in texts):
        raise InputError(f"{key}: should be a list of columns")
    return tuple(text.strip().strip("\"'") for text in texts)


CONVENTIONS = {
    "euler": _sequence,
    "attitude": _one_of("body-to-world", "world-to-body"),
    "world": _axes,
    "body": _axes,
    "earth_rate_rad_s": _rate,
    "time_origin": _one_of("file", "first-sample"),
    "topic": _text,
    "columns": _columns,
    "times": _text,
    "ignore": _texts,
}
"""Key of a map -> what checks and reads its value."""


@dataclass(frozen=True, eq=False)
class ColumnMap:
    """A map: target -> product, and the conventions of the file.

    euler: axes of euler_1_rad to euler_3_rad. attitude: which way quaternion, matrix and angles rotate.
    world, body: matrices (3, 3) from the file's axes to the scenario's, None where they are the same.
    time_origin: whether the scenario starts at t_s = 0 or at the first sample. topic: of an
    MCAP file. columns: the names of those of a file without a header. times: the path of a file with the
    time of each row in s, for a file without times. optional: target -> products, of which the first whose
    columns the file has is used. ignore: patterns of columns; "*" leaves out all but the standard ones.
    """

    products: Mapping[str, Product] = field(default_factory=dict)
    euler: str = ""
    attitude: str = "body-to-world"
    world: Array | None = None
    body: Array | None = None
    earth_rate_rad_s: float = EARTH_RATE_RAD_S
    time_origin: str = "file"
    topic: str = ""
    columns: tuple[str, ...] = ()
    times: str = ""
    optional: Mapping[str, tuple[Product, ...]] = field(default_factory=dict)
    ignore: tuple[str, ...] = ()

    def ignores(self, column: str) -> bool:
        """Whether a column of the file is left out, by its name or that of its array."""
        names = (column, column.partition("[")[0], _ARRAYS.get(column, column))
        patterns = (pattern for pattern in self.ignore if pattern != "*" or column not in KINDS)
        return any(name == pattern or fnmatchcase(name, pattern) for pattern in patterns for name in names)


MapSpec: TypeAlias = str | Path | Mapping[str, Any]
"""Pairs as text, the path of a TOML file, or the content of one."""


def read_map(specs: Sequence[MapSpec], like: str | None = None) -> ColumnMap:
    """Return the map of a built-in source, changed by further maps, each of which takes precedence.

    Raises InputError for an unknown source, key or unit, and for a file that cannot be read.
    """
    if like is None:
        return changed_map(ColumnMap(), specs)
    known = source(like)
    optional = {
        target: tuple(parse_product(text, target) for text in ([texts] if isinstance(texts, str) else texts))
        for target, texts in known.get("optional", {}).items()
    }
    return changed_map(ColumnMap(optional=optional), [known["map"], *specs])


def changed_map(column_map: ColumnMap, specs: Sequence[MapSpec]) -> ColumnMap:
    """Return a map changed by others, each of which takes precedence.

    Raises InputError as `read_map` does.
    """
    raw: Raw = {}
    ignored: list[str] = list(column_map.ignore)
    for spec in specs:
        for key, value in _pairs(spec):
            if key == "ignore":
                ignored += _texts(value, key)
            else:
                raw[key] = value
    products = dict(column_map.products)
    conventions: dict[str, Any] = {"ignore": tuple(ignored)}
    for key, value in raw.items():
        if key in CONVENTIONS:
            conventions[key] = CONVENTIONS[key](value, key)
        elif key not in KINDS:
            raise InputError(f"{key}: unknown key of a column map{suggestion(key, [*KINDS, *CONVENTIONS])}")
        elif isinstance(value, bool) or not isinstance(value, str | int | float):
            raise InputError(f'{key}: should be a product, like "p_deg_s*deg"')
        else:
            products[key] = parse_product(str(value), key)
    return replace(column_map, products=products, **conventions)


def _pairs(spec: MapSpec) -> Iterator[tuple[str, Any]]:
    """Yield the keys and values of a map."""
    if isinstance(spec, Mapping):
        yield from ((str(key), value) for key, value in spec.items())
        return
    if not isinstance(spec, str | Path):
        raise InputError(f"a column map must be text, a path or a mapping, not {spec!r}")
    path = Path(spec)
    if path.suffix == ".toml":
        yield from parse_toml(read_text(path), str(path)).items()
        return
    if _PAIR.sub("", str(spec)).strip(", "):
        raise InputError(f"--map {spec}: a quotation mark is not closed")
    for pair in _PAIR.findall(str(spec)):
        key, equals, value = pair.partition("=")
        if not equals or not key.strip() or not value.strip():
            raise InputError(f"--map {pair.strip()}: {_PAIR_FORM}")
        yield key.strip(), value.strip()


_SOURCES = files("bodycheck.recordings") / "sources"


def source_names() -> tuple[str, ...]:
    """Return the sources whose maps are built in, in alphabetical order."""
    return tuple(sorted(entry.name[:-5] for entry in _SOURCES.iterdir() if entry.name.endswith(".toml")))


def source(name: str) -> Raw:
    """Return a built-in source: `map`, its `optional` products, and `scenarios`: file name -> scenario.

    Raises InputError if there is no such source.
    """
    if name not in source_names():
        raise InputError(f"--like {name}: unknown source{suggestion(name, source_names())}")
    return parse_toml((_SOURCES / f"{name}.toml").read_text(encoding="utf-8"), name)


def scenario_of(like: str | None, path: Path) -> str | None:
    """Return the scenario that a source knows for a file, by its name; None if it knows none."""
    known: Mapping[str, str] = source(like).get("scenarios", {}) if like else {}
    return next((scenario for pattern, scenario in known.items() if fnmatchcase(path.name, pattern)), None)
