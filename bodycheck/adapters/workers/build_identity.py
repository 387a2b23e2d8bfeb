"""Identity of the code that a worker has loaded: a hash that is the key of stored answers.

The hash covers the whole package of the adapter and that of the engine, if its own distribution provides it;
the contents of every imported module and every mapped library; Python, numpy, numba, llvmlite and scipy,
which count from the start although they are imported later; the processor's features; and the environment
variables known to change results. A package is hashed by the files in its folder, not by its RECORD: a
library may belong to another distribution, and a file may have been patched.

Code that is loaded while a case runs changes the identity of that answer, which is then not stored. Only the
standard library and the system's libraries are assumed unmodified, and site-packages for an installed engine.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import sys
import sysconfig
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import Distribution
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from bodycheck._util.distributions import installed
from bodycheck._util.file_digests import Entry, content_digest, files_at, files_below
from bodycheck._util.platform_identity import VARIABLES, environment, library_roots, numeric_parts
from bodycheck.adapters.contract import Adapter, Build, BuildKind
from bodycheck.adapters.registry import distribution_of, own_code

_BEGIN_NS = time.time_ns()
_MAPS = Path("/proc/self/maps")
_DELETED = " (deleted)"  # Linux appends it to the path of a replaced file
_WITHOUT_EFFECT = (
    "_cffi_backend.",
    "cffi/",
    "cffi.libs/",
    "charset_normalizer/",
    "coverage/",
    "pycparser/",
    "yaml/",
)
_SYSTEM = ("/usr/lib/", "/lib/", "/usr/lib64/", "/lib64/")


class Loaded:
    """The build of an engine that this process has loaded; detects code that is loaded later.

    handed_over: whether the adapter was pickled by the run's process, so that it may hold any state.
    """

    def __init__(self, adapter: Adapter, *, handed_over: bool = False) -> None:
        self._engine, self._is_modified = adapter.name, False
        kind: BuildKind = "handed over" if handed_over else _kind(adapter)
        roots = dict(_roots(adapter))
        self._roots = _prefixes((*roots.values(), *library_roots(), _own_package()))
        self._trusted = _site_packages() if kind == "installed" else _packages_without_effect()
        parts = {
            **numeric_parts(),
            "environment": environment((*VARIABLES, *_variables_of(adapter.name))),
            "bodycheck": own_code()[:16],
            **{name: self._content(name, files_below(root)) for name, root in roots.items()},
        }
        if version := _version(adapter.name):
            parts["distribution"] = version
        self._count, self._files = _loaded_count(), self._elsewhere()
        self.build = self._with_elsewhere(Build("", kind, parts))

    def later(self) -> Build | None:
        """Return the new build if code was loaded since that may change an answer; None otherwise."""
        if (count := _loaded_count()) == self._count:
            return None
        self._count, found = count, self._elsewhere()
        new = found.keys() - self._files.keys()
        if all(self._is_trusted(found[name]) for name in new):
            return None
        self._files = found
        self.build = self._with_elsewhere(self.build)
        return self.build

    def _is_trusted(self, path: str) -> bool:
        """Return whether a file is assumed to be unmodified since its installation."""
        if path.startswith(_site_packages()):  # these lie within the standard library's folder
            return path.startswith(self._trusted)
        return path.startswith((*_standard_library(), *_SYSTEM))

    def _elsewhere(self) -> dict[str, str]:
        """Return name -> path of the loaded files outside the packages that are hashed as a whole."""
        found: dict[str, str] = {}
        for name, path in (*_imported(), *_mapped()):
            if not path.startswith(self._roots):
                found[name if found.get(name, path) == path else f"{name} {path}"] = path
        return found

    def _with_elsewhere(self, build: Build) -> Build:
        """Return the build with the files loaded from elsewhere, and with its id.

        The id is empty if a file has changed since this process started, because the file on the disk may
        then differ from the loaded one.
        """
        files = {name: file for name, path in self._files.items() for file in files_at([path])}
        parts = {**build.parts, "loaded": self._content(f"loaded {sys.prefix}", files)}
        unknown = self._is_modified or any(path.endswith(_DELETED) for path in self._files.values())
        text = json.dumps(parts)
        return Build("" if unknown else hashlib.sha256(text.encode()).hexdigest(), build.kind, parts)

    def _content(self, label: str, files: Mapping[str, Entry]) -> str:
        """Return a hash of files, and remember if one of them is newer than this process."""
        times = (max(status.st_mtime_ns, status.st_ctime_ns) for _, status in files.values())
        self._is_modified |= any(time_ns > _BEGIN_NS for time_ns in times)
        return content_digest(f"{self._engine} {label}", files)[:16]


def _kind(adapter: Adapter) -> BuildKind:
    if type(adapter).__module__.partition(".")[0] != "bodycheck":
        return "plug-in"
    name = distribution_of(adapter.name)
    return "installed" if name is None or _is_installed(name) else "development"


def _is_installed(name: str) -> bool:
    """Return whether a package is imported from its installed distribution, not from a source folder."""
    found = installed(name)
    if found is None:
        return False
    origin = found.read_text("direct_url.json")
    if origin is not None and _is_editable(origin):
        return False
    place = Path(str(found.locate_file("")))
    files = (Path(spec.origin) for spec in map(find_spec, _modules_of(found, name)) if spec and spec.origin)
    return any(file.is_relative_to(place) or file.resolve().is_relative_to(place) for file in files)


def _modules_of(found: Distribution, name: str) -> set[str]:
    """Return the top-level modules of a distribution, whose name may differ: pin provides pinocchio."""
    files = (str(file).rpartition("site-packages/")[2] for file in found.files or ())
    code = (file for file in files if file.endswith((".py", ".so")) and not file.startswith(".."))
    return {file.partition("/")[0].partition(".")[0] for file in code} or {name.replace("-", "_")}


def _is_editable(direct_url: str) -> bool:
    """Return whether pip recorded an editable install; an unreadable record counts as one."""
    try:
        return bool(json.loads(direct_url).get("dir_info", {}).get("editable"))
    except (ValueError, AttributeError):
        return True


def _version(engine: str) -> str | None:
    name = distribution_of(engine)
    found = None if name is None else installed(name)
    return None if found is None else f"{name} {found.version}"


def _roots(adapter: Adapter) -> Iterator[tuple[str, str]]:
    """Yield (part, folder) of the packages that are hashed as a whole: the engine's and the adapter's."""
    module = type(adapter).__module__.partition(".")[0]
    if module != "bodycheck" and (folder := _package_folder(module)):
        yield "adapter", folder
    name = distribution_of(adapter.name)
    if name is not None:
        top = name.replace("-", "_")
        if top != module and (folder := _package_folder(top)):
            yield "engine", folder
        site = installed(name)
        libraries = None if site is None else Path(str(site.locate_file(f"{top}.libs")))
        if libraries is not None and libraries.is_dir():
            yield "engine libraries", str(libraries)


def _package_folder(name: str) -> str | None:
    """Return the folder of a package; None for a single-file module, which is hashed as a file."""
    return next(iter(getattr(sys.modules.get(name), "__path__", ())), None)


def _own_package() -> str:
    return str(Path(__file__).parents[2])


def _variables_of(engine: str) -> tuple[str, ...]:
    """Return patterns of the variables that start with the name of the engine or of its package."""
    names = {engine, distribution_of(engine) or engine}
    return tuple(f"{name.upper().replace('-', '_')}_*" for name in sorted(names))


def _prefixes(folders: Iterable[str]) -> tuple[str, ...]:
    """Return what the paths of files in these folders begin with, also where the system resolves links."""
    names = dict.fromkeys(name for folder in folders for name in (folder, os.path.realpath(folder)))
    return tuple(f"{name}{os.sep}" for name in names)


@cache
def _standard_library() -> tuple[str, ...]:
    return _prefixes(map(sysconfig.get_path, ("stdlib", "platstdlib")))


@cache
def _site_packages() -> tuple[str, ...]:
    return _prefixes(map(sysconfig.get_path, ("purelib", "platlib")))


def _packages_without_effect() -> tuple[str, ...]:
    """Return how the paths of packages begin that numba imports if installed, but that change no result."""
    return tuple(f"{site}{name}" for site in _site_packages() for name in _WITHOUT_EFFECT)


def _loaded_count() -> tuple[int, int]:
    """Return the numbers of imported modules and of mapped libraries, which change if more is loaded."""
    return len(sys.modules), _libraries_ever_loaded()


def _imported() -> Iterator[tuple[str, str]]:
    """Yield (name, file) of the modules from files outside the standard library."""
    standard, sites = _standard_library(), _site_packages()
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__dict__", {}).get("__file__")  # getattr would import a lazy module
        if isinstance(file, str) and (not file.startswith(standard) or file.startswith(sites)):
            yield f"module {name}", file


def _mapped() -> Iterator[tuple[str, str]]:
    """Yield (name, file) of the files with mapped code; none without /proc."""
    with suppress(OSError):
        for line in os.fsdecode(_MAPS.read_bytes()).splitlines():
            fields = line.split(None, 5)
            if len(fields) == 6 and "x" in fields[1] and fields[5].startswith("/"):
                yield f"library {Path(fields[5]).name}", fields[5]


class _Object(ctypes.Structure):
    """The first fields of glibc's and musl's dl_phdr_info; adds: number of objects ever loaded."""

    _fields_ = (
        ("address", ctypes.c_void_p),
        ("name", ctypes.c_char_p),
        ("headers", ctypes.c_void_p),
        ("header_count", ctypes.c_uint16),
        ("adds", ctypes.c_ulonglong),
    )


_Visit = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(_Object), ctypes.c_size_t, ctypes.c_void_p)


def _ever_loaded(info: Any, size: int, data: int | None) -> int:  # noqa: ARG001 - the system's signature
    return int(info.contents.adds)  # not 0, so it ends the iteration, which returns it


_EVER_LOADED = _Visit(_ever_loaded)


@cache
def _iterate_libraries() -> Callable[[Any, None], int] | None:
    with suppress(OSError, AttributeError):
        found: Callable[[Any, None], int] = ctypes.CDLL(None).dl_iterate_phdr
        return found
    return None


def _libraries_ever_loaded() -> int:
    """Return how many libraries were loaded so far; 0 if the system does not count them."""
    iterate = _iterate_libraries()
    return 0 if iterate is None else iterate(_EVER_LOADED, None)
