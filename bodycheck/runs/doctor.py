"""What works in this installation, what does not, and why."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from bodycheck._util.cache_dir import cache_dir
from bodycheck._util.compiled_cache import cache_directory
from bodycheck._util.distributions import installed, requirements
from bodycheck._util.errors import InputError, UnavailableError
from bodycheck._util.file_digests import disk_bytes
from bodycheck._util.files import check_folder
from bodycheck._util.formatting import count, names
from bodycheck._util.platform_identity import cpu_model, usable_cores
from bodycheck.adapters.contract import Engine
from bodycheck.adapters.registry import default_engines, distribution_of, optional_engines
from bodycheck.adapters.versions.uv import uv_program
from bodycheck.adapters.workers.engine_pool import announced
from bodycheck.reference_impl.precompile import closed_forms_compiled
from bodycheck.reports.document import Document, Sentence, Table
from bodycheck.reports.summary.catalogue import on_request_state
from bodycheck.reports.table_layout import Column, Span

_NOT_LISTED = {"", "all", "bench", "docs", "engines", "release", "test"}
"""Extras of developers, and those whose packages stand in lines of their own."""


@dataclass(frozen=True)
class MachineCheck:
    """One capability: whether it works, and with what, or why not; optional: nothing else needs it."""

    name: str
    works: bool
    detail: str
    optional: bool = False


@dataclass(frozen=True)
class CacheFolder:
    """A folder of the cache: its content, its path and its size."""

    name: str
    folder: Path
    bytes: int


@dataclass(frozen=True)
class MachineReport:
    """The state of an installation: versions by name, folders of the cache, capabilities.

    on_request: name -> version and place of each engine that runs on request, or what it needs.
    """

    versions: dict[str, str]
    caches: tuple[CacheFolder, ...]
    checks: tuple[MachineCheck, ...]
    on_request: dict[str, str]


def diagnosis() -> MachineReport:
    """Start every engine and look at the cache and at the optional programs."""
    versions = {"bodycheck": version("bodycheck"), "Python": platform.python_version()}
    versions |= {name: _version(name) for name in requirements()[""] if installed(name) is not None}
    versions |= {
        "system": platform.platform(),
        "processor": f"{cpu_model()}, {usable_cores()} of {os.cpu_count()} cores",
    }
    on_request = {name: on_request_state(name) for name in optional_engines()}
    checks = (*_engines(), *_cache_checks(), *_optional(), _javascript())
    return MachineReport(versions, tuple(_caches()), checks, on_request)


def _caches() -> Iterator[CacheFolder]:
    for name in ("kernels", "results", "environments"):
        folder = cache_dir() / name
        yield CacheFolder(name, folder, disk_bytes([folder]))


def _engines() -> Iterator[MachineCheck]:
    for name, engine in announced(default_engines()).items():
        if isinstance(engine, Engine):
            yield MachineCheck(name, True, f"{engine.version}, {count(len(engine.methods), 'method')}")
        else:
            package = distribution_of(name)
            absent = package is not None and installed(package) is None
            yield MachineCheck(name, False, engine.removeprefix(f"{name} is "), optional=absent)


def _cache_checks() -> Iterator[MachineCheck]:
    home = cache_dir()
    try:
        check_folder(str(home), home)
        free = shutil.disk_usage(next(folder for folder in (home, *home.parents) if folder.exists())).free
        yield MachineCheck("cache", True, f"{home} is writable, {_size(free)} free")
    except InputError as error:
        yield MachineCheck("cache", False, f"{error}; every command compiles again; set BODYCHECK_CACHE_DIR")
    state = "compiled by the first run, which takes about a minute"
    if compiled := sum(1 for _ in cache_directory().glob("*/*.nbi")):
        state = "compiled" if closed_forms_compiled() else f"{compiled} compiled, others when first needed"
    yield MachineCheck("kernels", True, f"{state}: {cache_directory()}")


def _optional() -> Iterator[MachineCheck]:
    for extra, packages in requirements().items():
        if extra in _NOT_LISTED or extra in optional_engines():
            continue
        if extra == "versions":  # uv may also be a program on the path
            try:
                yield MachineCheck(extra, True, uv_program())
            except UnavailableError as error:
                yield MachineCheck(extra, False, str(error), optional=True)
        elif missing := [name for name in packages if installed(name) is None]:
            why = f"{', '.join(missing)} not installed: pip install 'bodycheck[{extra}]'"
            yield MachineCheck(extra, False, why, optional=True)
        else:
            yield MachineCheck(extra, True, ", ".join(f"{name} {_version(name)}" for name in packages))


def _javascript() -> MachineCheck:
    """Return the versions of node and npm, or which of them is missing."""
    programs = {name: shutil.which(name) for name in ("node", "npm")}
    if missing := [name for name, path in programs.items() if path is None]:
        why = f"not on the path: {', '.join(missing)}, of Node.js"
        return MachineCheck("JavaScript engines", False, why, optional=True)
    found = []
    for name, path in programs.items():
        done = subprocess.run([str(path), "--version"], capture_output=True, text=True, check=False)
        found.append(f"{name} {done.stdout.strip()}")
    return MachineCheck("JavaScript engines", True, ", ".join(found))


def _version(name: str) -> str:
    found = installed(name)
    return "not installed" if found is None else found.version


def _size(amount: int) -> str:
    return f"{amount / 1e9:.1f} GB" if amount >= 1e9 else f"{amount / 1e6:.0f} MB"


def diagnosis_document(found: MachineReport) -> Document:
    """Return what does not work, what works, what is not installed, then the caches and the versions."""
    absent = [one for one in found.checks if one.optional and not one.works]
    broken = [one for one in found.checks if not one.works and not one.optional]
    works = [one for one in found.checks if one.works]
    checks = (
        *((one.name, Span("does not work", "bad"), one.detail) for one in broken),
        *((one.name, Span("works", "good"), one.detail) for one in works),
        *((one.name, Span("not installed", "open"), one.detail) for one in absent),
    )
    text = "Everything that is installed works." if absent else "Everything works."
    first = Sentence(text, "good", strong=True)
    if broken:
        verb = "does" if len(broken) == 1 else "do"
        first = Sentence(f"{names([one.name for one in broken])} {verb} not work.", "bad", strong=True)
    caches = tuple((one.name, _size(one.bytes), str(one.folder)) for one in found.caches)
    return Document(
        "bodycheck doctor",
        (
            first,
            Table((Column("", "fixed"), Column("", "fixed"), Column("")), checks, "Capabilities"),
            Table((Column("", "fixed"), Column("")), tuple(found.on_request.items()), "Engines on request"),
            Table((Column("", "fixed"), Column("", "number"), Column("")), caches, "Caches"),
            Table((Column("", "fixed"), Column("")), tuple(found.versions.items()), "Versions"),
        ),
    )
