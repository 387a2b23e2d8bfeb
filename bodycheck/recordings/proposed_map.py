"""The map that is proposed for a file, guessed from names and values; it is tried before it is printed.

A map under which omega is the rate of the attitude is confirmed by the file itself; names of omega that state
its axes and its unit need not be, as what they state may be the fault that is looked for.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

import numpy as np

from bodycheck._util.errors import InputError
from bodycheck._util.formatting import nearest
from bodycheck._util.untrusted import shell_quote
from bodycheck.examine.diagnosis.attitude_readings import derived_rates
from bodycheck.recordings.column_map import (
    ATTITUDES,
    EULER,
    KINDS,
    UNITS,
    VECTORS,
    ColumnMap,
    changed_map,
    read_map,
    source_names,
)
from bodycheck.recordings.recording import Recording
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.one_step_maps.one_step_map import back
from bodycheck.reference_impl.rotations import geodesic_angle, normalised, quaternion_to_matrix

_AXIS_NAMES = ("x", "y", "z")
_ALIASES = {
    "t_s": ("t", "time", "times", "timestamp", "stamp", "simtime", "elapsedtime"),
    **{f"{axis}_m": (axis, f"p{axis}", f"t{axis}", f"pos{axis}", f"position{axis}") for axis in _AXIS_NAMES},
    **{f"v{axis}_m_s": (f"v{axis}", f"vel{axis}", f"velocity{axis}", f"{axis}dot") for axis in _AXIS_NAMES},
    **{f"v{axis}_body_m_s": (body, f"{body}body") for axis, body in zip(_AXIS_NAMES, "uvw", strict=True)},
    **{
        f"w{axis}_body_rad_s": (
            *(rate, f"{angle}rate", f"w{axis}", f"w{axis}body", f"omega{axis}", f"omegabody{axis}"),
            *(f"gyro{axis}", f"g{axis}", f"gyr{axis}", f"angularvelocity{axis}", f"angvel{axis}"),
            f"bodyrate{axis}",
        )
        for axis, rate, angle in zip(_AXIS_NAMES, "pqr", ("roll", "pitch", "yaw"), strict=True)
    },
    **{f"w{axis}_world_rad_s": (f"w{axis}world", f"omegaworld{axis}") for axis in _AXIS_NAMES},
    **{
        f"q{part}": (f"q{part}", f"q{index}", f"quat{part}", f"quaternion{part}", f"orientation{part}")
        for index, part in enumerate("wxyz")
    },
    **{f"modified_rodrigues_{axis}": (f"mrp{axis}", f"mrp{k}") for k, axis in enumerate(_AXIS_NAMES, 1)},
    **{f"rodrigues_{axis}": (f"gibbs{axis}", f"gibbs{k}") for k, axis in enumerate(_AXIS_NAMES, 1)},
    "euler_1_rad": ("yaw", "psi", "heading"),
    "euler_2_rad": ("pitch", "theta"),
    "euler_3_rad": ("roll", "phi"),
}
_TARGETS = {alias: target for target, aliases in _ALIASES.items() for alias in aliases}
_SPELLINGS = {
    "sec": "s",
    "secs": "s",
    "seconds": "s",
    "millis": "ms",
    "nanoseconds": "ns",
    "degrees": "deg",
    "feet": "ft",
    "dps": "deg",
    "fps": "ft",
    "mps": "m",
}
_PLAIN = re.compile(r"[^\W\d]\w*(?:\.\w+|\[[0-9]+\])*")
_MAX_IGNORED = 2
_SINCE_1970 = (("ns", 1e17), ("us", 1e14), ("ms", 1e11))  # the smallest stamp of this century in each unit
_LARGEST_ANGLE_RAD = 7.0
_DEGREES = (20.0, 160.0)  # a rate in degrees is 57 times that of the attitude in radians, or so
_CONFIRMED = 0.02  # of omega
_KITTI_DT_S = 0.1
_UNIT_ERROR = 0.01
_RATES = VECTORS["omega_body_rad_s"]
_FEWEST_COLUMNS = 4  # of a known source: a time and a vector

Trial = Callable[[ColumnMap, float | None], Mapping[str, Array]]
"""Map and interval between rows in s -> the arrays of the motion; raises InputError."""


def proposal(recording: Recording, known: ColumnMap, trial: Trial) -> tuple[str, ColumnMap | None, str]:
    """Return "--map ..." or "--like ..." for a file, the map where it can be assumed, and why it can or not.

    The option is "" where nothing that was tried works. known: the map that was given, whose keys are not
    proposed again.
    """
    if not known.products:
        for name in source_names():
            if _is_of(name, recording, trial):
                dt = f" --dt {_KITTI_DT_S} (the time between two rows in s)" if name == "kitti" else ""
                return f"--like {name}{dt}", None, ""
    pairs = _pairs(recording, known)
    arrays = _tried(known, pairs, trial)
    is_stated = any(target in _RATES for target in pairs) and all(
        _states(text) for target, text in pairs.items() if target in _RATES
    )
    if (
        arrays is not None
        and not is_stated
        and (scale := _rate_over_attitude(arrays))
        and _DEGREES[0] < scale < _DEGREES[1]
    ):
        pairs = {target: text + "*deg" * (target in _RATES) for target, text in pairs.items()}
        arrays = _tried(known, pairs, trial)
    if arrays is None:
        return "", None, ""
    text = _text(pairs)
    option = f"--map {shell_quote(text)}"
    off = _off_rate(arrays)
    if off is None or off < _CONFIRMED:
        why = "" if off is None else "omega is then the rate of the attitude"
        return option, None if off is None else changed_map(known, [text]), why
    if is_stated:
        return option, changed_map(known, [text]), "as its columns are named"
    in_world = {target.replace("_body_rad_s", "_world_rad_s"): product for target, product in pairs.items()}
    off = _off_rate(_tried(known, in_world, trial) or {})
    if off is None or off >= _CONFIRMED:
        return option, None, "omega is the rate of the attitude neither in body axes nor in world axes"
    # not assumed: an attitude that omega turns in the wrong axes looks the same
    why = "omega is the rate of the attitude in world axes, not in body axes"
    return f"--map {shell_quote(_text(in_world))}", None, why


def _off_rate(arrays: Mapping[str, Array]) -> float | None:
    """Return the median of |omega - rate of the attitude| over that of |omega|; None where one is absent.

    Where it is small, columns, axes, units and Euler sequence are right.
    """
    omega = arrays.get("omega_body_rad_s", arrays.get("omega_world_rad_s"))
    if omega is None or "quaternion" not in arrays or not np.isfinite(omega).all():
        return None
    if "omega_body_rad_s" not in arrays:
        omega = back(quaternion_to_matrix(normalised(arrays["quaternion"])), omega)
    derived = derived_rates(arrays["t_s"], arrays["quaternion"], 0.0)
    size = float(np.median(np.linalg.norm(omega, axis=-1)))
    if derived is None or size == 0.0:
        return None
    return float(np.median(np.linalg.norm(omega - derived[0], axis=-1))) / size


def _is_of(name: str, recording: Recording, trial: Trial) -> bool:
    """Whether a file is of a known source: its columns are there, and its attitude is a rotation."""
    source = read_map((), name)
    if not source.products and not source.columns and not source.optional:
        return False  # it describes itself
    without_times = source.columns and "t_s" not in source.products
    if source.columns and recording.is_named:
        return False
    products = (*source.products.values(), *(one for several in source.optional.values() for one in several))
    used = {column for product in products for column in product.columns} & {*recording.names}
    if not source.columns and len(used) < _FEWEST_COLUMNS:
        return False
    try:
        arrays = trial(source, _KITTI_DT_S if without_times else None)
    except InputError:
        return False
    sizes = [np.linalg.norm(arrays[key], axis=-1) for key in ("quaternion", "rotation") if key in arrays]
    return all(np.all(np.abs(size - 1.0) < _UNIT_ERROR) for size in sizes)


def _tried(known: ColumnMap, pairs: Mapping[str, str], trial: Trial) -> Mapping[str, Array] | None:
    if not set(pairs) - {"ignore"}:
        return None
    try:
        return trial(changed_map(known, [_text(pairs)]), None)
    except InputError:
        return None


def _text(pairs: Mapping[str, str]) -> str:
    ignored = [f"ignore={column}" for column in pairs.get("ignore", "").split("\n") if column]
    return ", ".join([*(f"{key}={value}" for key, value in pairs.items() if key != "ignore"), *ignored])


def _pairs(recording: Recording, known: ColumnMap) -> dict[str, str]:
    """Return target -> product as text; "ignore" has the other columns, one a line."""
    standard = {name for name in recording.names if name in KINDS and not known.ignores(name)}
    used = {name for product in known.products.values() for name, _ in product.names}
    used |= {name for product in known.products.values() for name in product.columns}
    left: list[str] = []
    found: dict[str, tuple[str, str]] = {}
    for column in recording.names:
        if column in used or column in KINDS or known.ignores(column):
            continue
        target, unit = _guess(column)
        if target is None or target in {*known.products, *standard, *found}:
            left.append(column)
        else:
            found[target] = (column, unit or _unit_of(recording, target, column))
    if any(unit == "*deg" for target, (_, unit) in found.items() if target in EULER):
        found |= {target: (found[target][0], "*deg") for target in EULER if target in found}
    present = {*known.products, *standard, *found}
    whole = [vector for vector, columns in VECTORS.items() if present >= {*columns}]
    attitudes = [vector for vector in ATTITUDES if vector in whole]
    for target in list(found):
        vector = next((one for one, columns in VECTORS.items() if target in columns), "t_s")
        is_second = vector in attitudes[1:]
        if (vector != "t_s" and vector not in whole) or is_second:
            left.append(found.pop(target)[0])
    pairs = {target: f"{_written(column)}{unit}" for target, (column, unit) in found.items()}
    if attitudes[:1] == ["euler"] and not known.euler:
        pairs["euler"] = "ZYX"
    if "t_s" in found and known.time_origin == "file" and _starts_late(recording, found["t_s"][0]):
        pairs["time_origin"] = "first-sample"
    if left:
        pairs["ignore"] = "*" if len(left) > _MAX_IGNORED else "\n".join(map(_written, left))
    return pairs


def _words(name: str) -> list[str]:
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+", name)]


def _states(product: str) -> bool:
    """Whether the name of a column of omega has its axes, the body's, and its unit."""
    words = _words(product)
    return "body" in words and words[-2:] == ["rad", "s"]


def _guess(column: str) -> tuple[str | None, str]:
    """Return the target that a column's name resembles, and the unit in the name, as a factor."""
    words = _words(column)
    units: list[str] = []
    while len(words) > 1 and _SPELLINGS.get(words[-1], words[-1]) in UNITS:
        word = words.pop()
        units.insert(0, _SPELLINGS.get(word, word))
    stems = ("".join(words), "".join(reversed(words)))
    target = next((_TARGETS[stem] for stem in stems if stem in _TARGETS), None) or nearest(column, KINDS)
    if target is None and len(words) > 1 and (close := nearest(stems[0], _TARGETS)):
        target = _TARGETS[close]
    factors = [unit for unit in units if UNITS[unit][0] != 1.0]
    return target, f"*{factors[0]}" if factors else ""


def _unit_of(recording: Recording, target: str, column: str) -> str:
    """Return the unit that the values of a column imply, as a factor."""
    try:
        if target == "t_s":
            first = float(recording.stamps(column, relative=False)[0][0])
            return next((f"*{unit}" for unit, least in _SINCE_1970 if first > least), "")
        if target in EULER:
            return "*deg" if np.nanmax(np.abs(recording.values(column))) > _LARGEST_ANGLE_RAD else ""
    except InputError:
        pass
    return ""


def _starts_late(recording: Recording, column: str) -> bool:
    """Whether a file begins after more time than it lasts, as with times since 1970, or before 0."""
    try:
        stamps, _ = recording.stamps(column, relative=False)
    except InputError:
        return False
    return not 0 <= stamps[0] <= stamps[-1] - stamps[0]


def _rate_over_attitude(arrays: Mapping[str, Array]) -> float | None:
    """Return the median of |omega| over that of the rate of the attitude; None where one is absent or 0."""
    if not {"quaternion", "omega_body_rad_s"} <= set(arrays) or len(arrays["t_s"]) < 2:
        return None
    q = arrays["quaternion"]
    turned = np.median(geodesic_angle(q[1:], q[:-1]) / np.diff(arrays["t_s"]))
    stated = np.median(np.linalg.norm(arrays["omega_body_rad_s"], axis=-1))
    return float(stated / turned) if turned > 0.0 else None


def _written(column: str) -> str:
    """Return a column as a map names it: quoted unless it is a plain name that is not a unit."""
    return column if _PLAIN.fullmatch(column) and column not in UNITS else f'"{column}"'
