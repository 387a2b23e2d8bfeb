"""Environments for engines in versions of their own: made once by uv, kept beside the other caches."""

from __future__ import annotations

import fcntl
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

from bodycheck.adapters.pins import Pin
from bodycheck.adapters.registry import distribution_of
from bodycheck.adapters.uv import UvError, uv
from bodycheck.errors import UnavailableError
from bodycheck.reference_impl.cache_home import cache_home

_NEEDED = ("numpy", "numba")
"""What the worker imports; where the engine allows it, in the versions that are here."""
_NEVER = "bodycheck ; python_version < '0'\n"
"""An adapter's own requirement of bodycheck is not to be met by a registry: the worker has this one."""


def python_of(pin: Pin) -> Path:
    """Return the Python of the environment that has the engine in this version; made where it is not there.

    Raises UnavailableError with one line where it cannot be made: no uv, no network, no such version.
    """
    home = cache_home() / "environments"
    place = home / _name(pin)
    python = place / "bin" / "python"
    if python.exists():
        return python
    try:
        home.mkdir(parents=True, exist_ok=True)
        with _locked(home / f"{place.name}.lock"):
            if not python.exists():  # while this one waited, another may have made it
                # on standard error, whoever asks: it takes a while to fetch some 100 MB
                print(f"making an environment for {pin.engine} {pin.version} ...", file=sys.stderr)
                _make(pin, place)
    except UvError as error:
        raise UnavailableError(f"{pin.name} cannot be installed: {error}") from None
    except OSError as error:
        raise UnavailableError(
            f"{pin.name} cannot be installed: {place}: {error.strerror or error}"
        ) from None
    return python


def _name(pin: Pin) -> str:
    """Return the folder of an environment: another one for another Python, or for what else is in it."""
    rest = "\n".join([sys.version, sys.base_prefix, *_as_here()])
    return f"{pin.engine}-{pin.version}-{sha256(rest.encode()).hexdigest()[:12]}"


def _as_here() -> list[str]:
    return [f"{name}=={version(name)}" for name in _NEEDED]


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Wait until no other process makes the same environment; the lock goes with the process that has it."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _make(pin: Pin, place: Path) -> None:
    """Make the environment under another name, so that half of one never counts."""
    unfinished = place.with_name(f"{place.name}.part")
    shutil.rmtree(unfinished, ignore_errors=True)
    try:
        uv("venv", "--python", sys.executable, str(unfinished))
        try:
            _install(pin, unfinished, _as_here())
        except UvError as error:
            if not error.refused:
                raise
            _install(pin, unfinished, [])
        shutil.rmtree(place, ignore_errors=True)  # one whose Python has gone
        unfinished.rename(place)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _install(pin: Pin, environment: Path, constraints: Sequence[str]) -> None:
    within, without = environment / "constraints.txt", environment / "overrides.txt"
    within.write_text("\n".join(constraints), encoding="utf-8")
    without.write_text(_NEVER, encoding="utf-8")
    uv(
        *("pip", "install", "--python", str(environment / "bin" / "python"), "--no-build"),
        *("-c", str(within), "--override", str(without)),
        f"{distribution_of(pin.engine)}=={pin.version}",
        *_NEEDED,
    )
