"""Format numbers, steps and lists as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from itertools import islice
from pathlib import Path

_MAX_NAMES = 8
_MAX_LISTED = 3
_MAX_BESIDE = 10_000
_NEARLY = 0.8  # one or two typing errors in a name of ten letters


def number(value: float | None, digits: int = 4) -> str:
    """Return value with so many significant digits, without trailing zeros; "" for None or NaN."""
    if value is None or value != value:
        return ""
    return _short_exponent(f"{value:.{digits}g}")


def scientific(value: float) -> str:
    """Return value as 2.78e-2, or as 0, 0.315 or 2.78 near 1."""
    return number(value, 3) if value == 0.0 or 0.1 <= value < 1000.0 else _short_exponent(f"{value:.2e}")


def brief(value: float | None) -> str:
    """Return value with at most three digits in the shorter of two forms, as 0.05, 1e-3 or 4.63e-4."""
    plain = number(value, 3)
    if not plain or value in (None, 0.0):
        return plain
    mantissa, _, exponent = f"{value:.2e}".partition("e")
    power = f"{mantissa.rstrip('0').rstrip('.')}e{int(exponent)}"
    return power if len(power) < len(plain) else plain


def _short_exponent(text: str) -> str:
    mantissa, e, exponent = text.partition("e")
    return f"{mantissa}e{int(exponent)}" if e else text


def step(dt_s: float | None) -> str:
    """Return a step with all digits, so that it parses to the same double; "" for None."""
    return "" if dt_s is None else _short_exponent(repr(dt_s))


def setting(control: str | None, fineness: float | None) -> str:
    """Return "dt 0.01 s", "tolerance 1e-6", or "no steps"."""
    if fineness is None:
        return "no steps"
    return f"dt {step(fineness)} s" if control == "dt" else f"tolerance {step(fineness)}"


def vector(values: Iterable[float]) -> str:
    """Return "(x, y, z)", each with 6 digits."""
    return f"({', '.join(number(value, 6) for value in values)})"


def first_few(items: Iterable[str]) -> str:
    """Return 'one; two; three; ...'."""
    listed = list(islice(items, _MAX_LISTED + 1))
    return "; ".join(listed[:_MAX_LISTED] + ["..."] * (len(listed) > _MAX_LISTED))


def names(items: Sequence[str]) -> str:
    """Return "a, b and c"; a long list ends with the number of further items."""
    if len(items) > _MAX_NAMES:
        items = [*items[: _MAX_NAMES - 1], f"{len(items) - _MAX_NAMES + 1} more"]
    return " and ".join(filter(None, (", ".join(items[:-1]), *items[-1:])))


def count(amount: int, noun: str) -> str:
    """Return "1 case", "2 cases"."""
    return f"{amount} {noun}" if amount == 1 else f"{amount} {noun}s"


def suggestion(typed: str, known: Iterable[str]) -> str:
    """Return "; did you mean NAME?" for a known name that resembles what was typed, else all known names."""
    names = tuple(known)
    near = nearest(typed, names)
    return f" (available: {', '.join(names) or 'none'})" if near is None else f"; did you mean {near}?"


def unread(path: Path, error: OSError) -> str:
    """Return "PATH: cannot be read: ..."; a missing file names the file next to it that resembles it."""
    reason = f"{path}: cannot be read: {error.strerror or error}"
    if not isinstance(error, FileNotFoundError):
        return reason
    try:
        beside = [one.name for one in islice(path.parent.iterdir(), _MAX_BESIDE)]
    except OSError:
        return reason
    near = nearest(path.name, beside)
    return f"{reason}; did you mean {path.parent / near}?" if near else reason


def nearest(typed: str, known: Iterable[str]) -> str | None:
    """Return the known name that resembles what was typed; None if there is none."""
    names = {name.lower().replace("_", "-"): name for name in known}
    near = get_close_matches(typed.lower().replace(" ", "-").replace("_", "-"), names, n=1, cutoff=_NEARLY)
    return names[near[0]] if near else None
