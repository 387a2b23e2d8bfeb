"""Environments for pinned engine versions, made once by uv and stored in the cache folder."""

from __future__ import annotations

import fcntl
import json
import re
import shutil
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

from bodycheck._util.cache_dir import cache_home
from bodycheck._util.errors import UnavailableError
from bodycheck._util.file_digests import files_below
from bodycheck.adapters.registry import distribution_of
from bodycheck.adapters.versions.pins import Pin
from bodycheck.adapters.versions.uv import UvError, index_settings, uv

_NEEDED = ("numpy", "numba", "pydantic")
"""The worker's imports, installed in the versions of the current environment if the engine allows it."""
_FACTS = "bodycheck.json"
"""File in an environment: its engine and version, and the sources of its packages."""
_NEVER = "bodycheck ; python_version < '0'\n"
"""Overrides an adapter's requirement of bodycheck, because the worker uses the running bodycheck."""


def python_of(pin: Pin) -> Path:
    """Return the Python of the environment with this version of the engine; make it if it does not exist.

    Raises UnavailableError with one line if it cannot be made: no uv, no network, no such version.
    """
    home = cache_home() / "environments"
    place = home / _name(pin)
    python = place / "bin" / "python"
    if python.exists():
        return python
    try:
        home.mkdir(parents=True, exist_ok=True)
        with _locked(home / f"{place.name}.lock"):
            if not python.exists():  # another process may have made it meanwhile
                # always reported, because downloading about 100 MB takes a while
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
    """Return the folder name of an environment, which depends on Python, index and the other packages."""
    rest = "\n".join([sys.version, sys.base_prefix, *_as_here(), *index_settings()])
    return f"{pin.engine}-{pin.version}-{sha256(rest.encode()).hexdigest()[:12]}"


def _as_here() -> list[str]:
    return [f"{name}=={version(name)}" for name in _NEEDED]


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Wait until no other process makes the same environment; the lock is released if its process dies."""
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _make(pin: Pin, place: Path) -> None:
    """Make the environment under a temporary name, so that an incomplete one is never used."""
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
        facts = {"engine": pin.engine, "version": pin.version, "from": _without_passwords(index_settings())}
        (unfinished / _FACTS).write_text(json.dumps(facts), encoding="utf-8")
        shutil.rmtree(place, ignore_errors=True)  # a remainder whose Python is missing
        unfinished.rename(place)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _without_passwords(settings: Iterable[str]) -> list[str]:
    return [re.sub(r"//[^/@\s]+@", "//", setting) for setting in settings]


@dataclass(frozen=True)
class Environment:
    """An existing environment: folder, engine==version, sources of its packages, size in bytes."""

    folder: Path
    name: str
    packages_from: tuple[str, ...]
    size: int


def environments() -> list[Environment]:
    """Return the existing environments, sorted by name; an incomplete one has the name of its folder."""
    home = cache_home() / "environments"
    folders = [folder for folder in home.iterdir() if folder.is_dir()] if home.is_dir() else []
    return sorted((_environment(folder) for folder in folders), key=lambda found: (found.name, found.folder))


def _environment(folder: Path) -> Environment:
    size = sum(status.st_size for _, status in files_below(str(folder)).values())
    try:
        facts = json.loads((folder / _FACTS).read_text(encoding="utf-8"))
        return Environment(folder, Pin(facts["engine"], facts["version"]).name, tuple(facts["from"]), size)
    except (OSError, ValueError, KeyError, TypeError):
        return Environment(folder, folder.name, (), size)


def remove(environment: Environment) -> None:
    """Remove an environment, after waiting for a process that is making it; raises OSError."""
    lock = environment.folder.with_name(f"{environment.folder.name}.lock")
    with _locked(lock):
        shutil.rmtree(environment.folder)
        lock.unlink()


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
