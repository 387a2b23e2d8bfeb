"""Environments of engines that do not run next to bodycheck, created once and stored in the cache folder.

These are engines in a pinned version, and engines whose adapter states requirements that are not installed
here. uv makes an environment of Python packages, npm a folder of JavaScript packages.
"""

from __future__ import annotations

import fcntl
import json
import platform
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import distribution, distributions, version
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from bodycheck._util.cache_dir import cache_dir
from bodycheck._util.distributions import installed
from bodycheck._util.errors import UnavailableError
from bodycheck._util.file_digests import disk_bytes
from bodycheck.adapters.engine_names import Pin, Program, pin_of
from bodycheck.adapters.registry import distribution_of, plug_in_of, stated_by
from bodycheck.adapters.versions.uv import UvError, in_one_line, index_settings, uv

_NEEDED = ("numpy", "numba", "pydantic")
"""The worker's imports, installed in the versions of the current environment if the engine allows it."""
_FACTS = "bodycheck.json"
"""File in an environment: its engine and version, and the sources of its packages."""
_UNFINISHED = ".part"
"""End of the name of a folder that is not an environment yet."""
_PYTHONS = ("3.11", "3.12", "3.13", "3.14")
"""The versions of Python that a worker can run in."""
_NEVER = b"bodycheck ; python_version < '0'\n"
"""Overrides an adapter's requirement of bodycheck, because the worker uses the running bodycheck."""
_PACKAGE = re.compile(r"@?[A-Za-z0-9._/-]+")
_EXTRAS = re.compile(r"\[[^]]+\]")
NODE_PACKAGES = "BODYCHECK_NODE_PACKAGES"
"""Variable of a JavaScript worker: the folder whose node_modules has its engine."""


def needed_environment(name: str) -> Pin | None:
    """Return which environment an engine, NAME or NAME==VERSION, needs; None if it runs next to bodycheck."""
    if pin := pin_of(name):
        return pin
    stated = stated_by(name)
    requires: Sequence[str] = getattr(stated, "requires", ())
    if requires and (_is_javascript(stated) or not all(map(_is_installed_here, requires))):
        return Pin(name, None)
    return None


def python_of(pin: Pin) -> Path:
    """Return the Python of the environment with this version of the engine; make it if it does not exist.

    Raises UnavailableError with one line if it cannot be made: no uv, no network, no such version.
    """
    return _made(pin) / "bin" / "python"


def program_in(pin: Pin) -> Program | None:
    """Return the program of a JavaScript engine, with its environment made if it does not exist; else None.

    Raises UnavailableError with one line if it cannot be made: no Node, no network, no such version.
    """
    stated = stated_by(pin.engine)
    if not _is_javascript(stated):
        return None
    for program in ["node"] if is_made(pin) else ["node", "npm"]:
        if shutil.which(program) is None:
            raise UnavailableError(f"{pin.name} needs Node.js, but {program} is not on the path")
    return Program(command=["node", str(stated.worker)], environment={NODE_PACKAGES: str(_made(pin))})


def is_made(pin: Pin) -> bool:
    """Whether the environment exists."""
    return _is_complete(_place(pin))


def installed_version(engine: str) -> str | None:
    """Return the version of an engine that runs on request, here or in its environment; None if not made.

    It is read from the metadata of its package: no engine is imported.
    """
    package = distribution_of(engine)
    pin = needed_environment(engine)
    if pin is None:
        found = None if package is None else installed(package)
        return None if found is None else found.version
    place = _place(pin)
    if not is_made(pin):
        return None
    if _is_javascript(stated_by(engine)):
        facts = (place / "node_modules" / str(package) / "package.json").read_bytes()
        return str(json.loads(facts)["version"])
    sites = [str(site) for site in place.glob("lib/python*/site-packages")]
    return next((one.version for one in distributions(name=package, path=sites)), None)


def requirements_of(pin: Pin) -> list[str]:
    """Return the requirements of an engine, with the pinned version in place of that of its package."""
    package = distribution_of(pin.engine)
    requires: Sequence[str] = getattr(stated_by(pin.engine), "requires", ())
    if pin.version is None:
        return list(requires)
    sign = "@" if _is_javascript(stated_by(pin.engine)) else "=="
    extras = next((_EXTRAS.search(one) for one in requires if _package_of(one) == package), None)
    pinned = f"{package}{extras[0] if extras else ''}{sign}{pin.version}"
    return [pinned, *(other for other in requires if _package_of(other) != package)]


def _is_javascript(stated: Any) -> bool:
    return hasattr(stated, "worker")


def _package_of(requirement: str) -> str:
    """Return the name of the package of a requirement in pip's or npm's notation."""
    found = _PACKAGE.match(requirement)
    return found.group() if found else requirement


def _is_installed_here(requirement: str) -> bool:
    """Whether the package is installed, in any version: pip has checked versions where it is by an extra."""
    return installed(_package_of(requirement)) is not None


def _made(pin: Pin) -> Path:
    place = _place(pin)
    if _is_complete(place):
        return place
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with _locked(place):
            if not _is_complete(place):  # another process may have made it meanwhile
                # always reported, because downloading about 100 MB takes a while
                print(f"creating an environment for {pin.name.replace('==', ' ')} ...", file=sys.stderr)
                begin = time.monotonic()
                _make(pin, place)
                size, seconds = disk_bytes([place]) / 1e6, time.monotonic() - begin
                print(f"  made in {seconds:.0f} s, {size:.0f} MB: {place}", file=sys.stderr)
    except UvError as error:
        raise UnavailableError(f"{pin.name} cannot be installed: {error}") from None
    except OSError as error:
        raise UnavailableError(
            f"{pin.name} cannot be installed: {place}: {error.strerror or error}"
        ) from None
    return place


def _is_complete(place: Path) -> bool:
    return (place / "bin" / "python").exists() or (place / "node_modules").exists()


def _place(pin: Pin) -> Path:
    """Return the folder of an environment, whose name has a hash of all that determines its packages."""
    stated = stated_by(pin.engine)
    rest: list[str] = []
    if not _is_javascript(stated):
        rest += [sys.version, sys.base_prefix, *_as_here(), *index_settings()]
    if hasattr(stated, "requires"):
        rest += [getattr(stated, "requires_python", ""), *requirements_of(pin)]
    digest = sha256("\n".join(rest).encode()).hexdigest()[:12]
    return cache_dir() / "environments" / f"{pin.name.replace('==', '-')}-{digest}"


def _as_here() -> list[str]:
    return [f"{name}=={version(name)}" for name in _NEEDED]


def _other_python(pin: Pin) -> str | None:
    """Return another Python for which an engine and the worker's imports have wheels; None if there is none.

    An installed one is preferred to one that would have to be downloaded.
    """
    released, _ = _plug_in(pin)
    wanted = "\n".join([*requirements_of(pin), *released, *_NEEDED])
    here = f"{sys.version_info[0]}.{sys.version_info[1]}"
    others = sorted((one for one in _PYTHONS if one != here), key=_must_be_downloaded)
    return next((one for one in others if _has_wheels(wanted, one)), None)


def _has_wheels(requirements: str, python: str) -> bool:
    """Whether there are wheels of all packages for a version of Python; raises UvError without network."""
    options = ("--python", sys.executable, "--python-version", python, "--no-build", "--no-header", "-")
    try:
        uv("pip", "compile", *options, stdin=requirements)
    except UvError as error:
        if not error.refused:
            raise
        return False
    return True


def _must_be_downloaded(python: str) -> bool:
    try:
        uv("python", "find", "--no-project", python)
    except UvError:
        return True
    return False


@contextmanager
def _locked(place: Path) -> Iterator[None]:
    """Wait until no other process makes the same environment; the lock is released if its process dies.

    The file stays, because a process that waits for a deleted one would not exclude later processes.
    """
    with place.with_name(f"{place.name}.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _make(pin: Pin, place: Path) -> None:
    """Make the environment under a temporary name, so that an incomplete one is never used."""
    unfinished = place.with_name(f"{place.name}{_UNFINISHED}")
    shutil.rmtree(unfinished, ignore_errors=True)
    try:
        if _is_javascript(stated_by(pin.engine)):
            unfinished.mkdir()
            _npm_install(requirements_of(pin), unfinished)
        else:
            _make_python(pin, unfinished)
        facts = {"engine": pin.engine, "version": pin.version, "from": _without_passwords(index_settings())}
        (unfinished / _FACTS).write_bytes(json.dumps(facts).encode())
        shutil.rmtree(place, ignore_errors=True)  # a remainder whose Python is missing
        unfinished.rename(place)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _make_python(pin: Pin, environment: Path) -> None:
    stated = getattr(stated_by(pin.engine), "requires_python", "")
    try:
        _make_with(pin, environment, stated)
    except UvError as error:
        other = _other_python(pin) if error.refused and not stated else None
        if other is None:
            raise
        print(f"  no wheels for Python {platform.python_version()}: uses Python {other}", file=sys.stderr)
        shutil.rmtree(environment)
        _make_with(pin, environment, other)


def _make_with(pin: Pin, environment: Path, other: str) -> None:
    """Make an environment with another Python, which may have to be downloaded, or the current one for ""."""
    # the working directory may be a project of anybody
    python = other or sys.executable
    uv("venv", "--python", python, "--no-project", str(environment), downloads=bool(other))
    try:
        _install(pin, environment, _as_here())
    except UvError as error:
        if not error.refused:
            raise
        _install(pin, environment, [])


def _npm_install(requirements: Sequence[str], folder: Path) -> None:
    """Install JavaScript packages into a folder, without running their scripts; raises UvError."""
    (folder / "package.json").write_bytes(b'{"private": true}')
    quiet = ("--no-audit", "--no-fund", "--ignore-scripts", "--loglevel=error")
    command = ["npm", "install", *quiet, "--prefix", str(folder), *requirements]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    if done.returncode != 0:
        raise UvError(in_one_line(done.stderr), refused=True)


def _without_passwords(settings: Iterable[str]) -> list[str]:
    return [re.sub(r"//[^/@\s]+@", "//", setting) for setting in settings]


@dataclass(frozen=True)
class Environment:
    """An existing environment: folder, engine or engine==version, sources of its packages, size in bytes."""

    folder: Path
    name: str
    packages_from: tuple[str, ...]
    size: int


def environments() -> list[Environment]:
    """Return the existing environments, sorted by name; an incomplete one has the name of its folder."""
    root = cache_dir() / "environments"
    folders = [folder for folder in root.iterdir() if folder.is_dir()] if root.is_dir() else []
    return sorted((_environment(folder) for folder in folders), key=lambda found: (found.name, found.folder))


def _environment(folder: Path) -> Environment:
    size = disk_bytes([folder])
    try:
        facts = json.loads((folder / _FACTS).read_bytes())
        return Environment(folder, Pin(facts["engine"], facts["version"]).name, tuple(facts["from"]), size)
    except (OSError, ValueError, KeyError, TypeError):
        return Environment(folder, folder.name, (), size)


def remove(environment: Environment) -> None:
    """Remove an environment, after waiting for a process that is making it; raises OSError."""
    folder = environment.folder
    place = folder.with_name(folder.name.removesuffix(_UNFINISHED))
    with _locked(place):
        shutil.rmtree(folder if folder.exists() else place)  # it may have been completed meanwhile


def _install(pin: Pin, environment: Path, constraints: Sequence[str]) -> None:
    constraints_file, overrides_file = environment / "constraints.txt", environment / "overrides.txt"
    constraints_file.write_bytes("\n".join(constraints).encode())
    overrides_file.write_bytes(_NEVER)
    install = ("pip", "install", "--python", str(environment / "bin" / "python"))
    released, local = _plug_in(pin)
    uv(
        *(*install, "--no-build", "-c", str(constraints_file), "--override", str(overrides_file)),
        *requirements_of(pin),
        *released,
        *_NEEDED,
        progress=True,
    )
    if local is not None:
        uv(*install, "--no-deps", local)


def _plug_in(pin: Pin) -> tuple[list[str], str | None]:
    """Return the requirements of the plug-in that drives another package, and its folder if it is local.

    A local plug-in is built from its folder, without its requirements, which are those returned.
    """
    name = plug_in_of(pin.engine)
    if name is None or name == distribution_of(pin.engine):
        return [], None
    found = distribution(name)
    origin = json.loads(found.read_text("direct_url.json") or "{}").get("url", "")
    if not origin.startswith("file://"):
        return [f"{name}=={found.version}"], None
    return [line for line in found.requires or () if "extra ==" not in line], unquote(urlsplit(origin).path)
