"""The known engines, and their import."""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from bodycheck._util.distributions import installed
from bodycheck._util.errors import InputError, UnavailableError
from bodycheck._util.file_digests import digest_of
from bodycheck._util.formatting import suggestion
from bodycheck.adapters.contract import Adapter

if TYPE_CHECKING:
    from bodycheck.adapters.engine_names import Program

_BUILT_IN = {
    "mujoco": ("bodycheck.adapters.mujoco", "MuJoCo"),
    "pybullet": ("bodycheck.adapters.pybullet", "PyBullet"),
    "dart": ("bodycheck.adapters.dart", "Dart"),
    "reference": ("bodycheck.adapters.reference", "Reference"),
}
_OPTIONAL = {
    "rapier": ("bodycheck.adapters.optional.rapier", "Rapier"),
    "rapier-js": ("bodycheck.adapters.optional.javascript", "RAPIER"),
    "jolt-js": ("bodycheck.adapters.optional.javascript", "JOLT"),
    "cannon-es": ("bodycheck.adapters.optional.javascript", "CANNON"),
    "drake": ("bodycheck.adapters.optional.drake", "Drake"),
    "pinocchio": ("bodycheck.adapters.optional.pinocchio", "Pinocchio"),
    "scipy": ("bodycheck.adapters.optional.scipy_solvers", "SciPy"),
    "heyoka": ("bodycheck.adapters.optional.heyoka_taylor", "Heyoka"),
    "newton": ("bodycheck.adapters.optional.newton", "Newton"),
    "mujoco-warp": ("bodycheck.adapters.optional.mujoco_warp", "MuJoCoWarp"),
    "mjx": ("bodycheck.adapters.optional.mjx", "Mjx"),
    "sapien": ("bodycheck.adapters.optional.sapien", "Sapien"),
    "exudyn": ("bodycheck.adapters.optional.exudyn", "Exudyn"),
    "basilisk": ("bodycheck.adapters.optional.basilisk", "Basilisk"),
    "simbody": ("bodycheck.adapters.optional.simbody", "Simbody"),
    "ode": ("bodycheck.adapters.optional.ode", "Ode"),
    "jsbsim": ("bodycheck.adapters.optional.jsbsim", "JSBSim"),
}
"""Adapters of engines that are not installed with bodycheck, and that run only if requested by name.

They state what their engine needs (`contract.Requirements`), and import it when they are made.
"""
_DISTRIBUTIONS = {"mujoco": "mujoco", "pybullet": "pybullet", "dart": "dartpy"}
_INSTALL = "pip install 'bodycheck[engines]'"
_registered: dict[str, Adapter] = {}
_programs: dict[str, tuple[Program, Path | None]] = {}
"""Name of an engine -> its program, which may be started, and the file that names it."""
_commands: dict[str, str] = {}
"""Name that a program announced -> cmd:COMMAND, as which it was requested."""


_HELD: tuple[dict[str, Any], ...] = (_registered, _programs, _commands)

_CONTRACT = ("name", "version", "methods", "unsupported", "build")


def register_adapter(adapter: Adapter) -> None:
    """Register an engine under adapter.name, replacing any other of that name.

    Raises InputError if it lacks an attribute of the contract.
    """
    if missing := [part for part in _CONTRACT if not hasattr(adapter, part)]:
        raise InputError(f"{adapter!r} is not an adapter: it has no {', no '.join(missing)}")
    _registered[adapter.name] = adapter


@contextmanager
def registered(*adapters: Adapter) -> Iterator[None]:
    """Register engines for the duration of a with block; what is registered within it is removed too."""
    before = [(held, dict(held)) for held in _HELD]
    try:
        for adapter in adapters:
            register_adapter(adapter)
        yield
    finally:
        for held, former in before:
            held.clear()
            held.update(former)


def register_program(engine: str, program: Program, file: Path | None = None) -> None:
    """Let a program be started as this engine; file: the one that names it.

    Only `engine_names`, which asks whether the code is allowed, and the run of another process call this.
    """
    _programs[engine] = program, file


def register_announced(engine: str, command: str) -> None:
    """Let the program that was requested as cmd:COMMAND also be known by the name that it announced.

    A program that is only known from a stored run is not started by that name.
    """
    if engine not in engine_names():
        _commands[engine] = command
        if command in _programs:
            _programs[engine] = _programs[command]


def requested_name(engine: str) -> str:
    """Return cmd:COMMAND of a program that is known by the name that it announced, else the name itself."""
    return _commands.get(engine, engine)


def program_of(engine: str) -> Program | None:
    """Return the program of an engine; None for any other engine, and for one that may not be started."""
    return _programs.get(engine, (None, None))[0]


def program_file(engine: str) -> Path | None:
    """Return the file that names the program of an engine."""
    return _programs.get(engine, (None, None))[1]


def engine_names() -> tuple[str, ...]:
    """Return the names of all known engines, whether or not they can be imported."""
    return tuple(dict.fromkeys([*default_engines(), *_OPTIONAL]))


def default_engines() -> tuple[str, ...]:
    """Return the names of the engines that run unless others are requested."""
    return tuple(dict.fromkeys([*_BUILT_IN, *_plugged_in(), *_registered]))


def engines_to_install() -> str:
    """Return how to install the engines if none is installed that would run by default, else ""."""
    if _plugged_in() or _registered or any(installed(package) for package in _DISTRIBUTIONS.values()):
        return ""
    return _INSTALL


def optional_engines() -> tuple[str, ...]:
    """Return the names of the engines that run only if requested by name."""
    return tuple(name for name in _OPTIONAL if name not in default_engines())


def stated_by(engine: str) -> Any:
    """Return the class of an optional adapter, or its object, without importing the engine.

    It has the attributes of `contract.Requirements` that the adapter states, if any. Of a plug-in, whose code
    runs in workers only, these attributes are read from its source, where they must be literals. None for
    other engines.
    """
    if engine in _registered or engine in _BUILT_IN:
        return None
    if engine in _plugged_in():
        return SimpleNamespace(**_stated_in_source(_plugged_in()[engine]))
    if engine not in _OPTIONAL:
        return None
    module, attribute = _OPTIONAL[engine]
    return getattr(importlib.import_module(module), attribute)


_STATED = ("distribution", "requires", "requires_python")


def _stated_in_source(point: EntryPoint) -> dict[str, Any]:
    """Return the attributes of `contract.Requirements` that a class states in the source of its module."""
    top, *inner = point.module.split(".")
    spec = find_spec(top)  # imports nothing, unlike that of a module within a package
    if spec is None or spec.origin is None:
        return {}
    root = Path(spec.origin)
    path_in_package = root.parent.joinpath(*inner)
    for path in (path_in_package.with_suffix(".py"), path_in_package / "__init__.py") if inner else (root,):
        with suppress(OSError, ValueError, SyntaxError):
            return dict(_literals(ast.parse(path.read_bytes()), point.attr))
    return {}


def _literals(module: ast.Module, name: str) -> Iterator[tuple[str, Any]]:
    for part in module.body:
        if isinstance(part, ast.ClassDef) and part.name == name:
            for line in part.body:
                target = line.targets[0] if isinstance(line, ast.Assign) else getattr(line, "target", None)
                if isinstance(target, ast.Name) and target.id in _STATED:
                    with suppress(ValueError):
                        yield target.id, ast.literal_eval(line.value)  # type: ignore[attr-defined]


def distribution_of(engine: str) -> str | None:
    """Return the package that provides the engine and its version.

    That is the `distribution` that an adapter states, else the package of a plug-in's entry point.
    Returns None for an engine without a package: the reference, and those passed to register_adapter.
    """
    if engine in _DISTRIBUTIONS:
        return _DISTRIBUTIONS[engine]
    stated = getattr(stated_by(engine), "distribution", None)
    return stated if isinstance(stated, str) else plug_in_of(engine)


def plug_in_of(engine: str) -> str | None:
    """Return the package of the entry point of an engine; None for an engine that is not a plug-in."""
    point = _plugged_in().get(engine)
    return None if point is None or point.dist is None else point.dist.name


def registered_adapter(name: str) -> Adapter | None:
    """Return the adapter registered under this name; None for an engine that any process can import."""
    return _registered.get(name)


@cache
def own_code() -> str:
    """Return a hash of the sources of _util, reference_impl and adapters."""
    package = Path(__file__).parents[1]
    digests = [digest_of(package / room) for room in ("_util", "reference_impl", "adapters")]
    return sha256(" ".join(digests).encode()).hexdigest()


def get_adapter(name: str) -> Adapter:
    """Return the engine of that name, imported on first use.

    Raises InputError for an unknown name, UnavailableError if the import fails.
    """
    if name in _registered:
        return _registered[name]
    if name not in engine_names():
        raise InputError(f"unknown engine {name!r}{suggestion(name, engine_names())}")
    return _import(name)


@cache
def _plugged_in() -> dict[str, EntryPoint]:
    """Return the engines of other packages: the entry points of the group bodycheck.adapters."""
    return {point.name: point for point in entry_points(group="bodycheck.adapters")}


def _remedy(engine: str) -> str:
    """Return how to get an engine of the extra `engines`."""
    if engine == "pybullet" and sys.version_info >= (3, 12):
        return "it has no wheels for Python 3.12 and later"
    return _INSTALL


@cache
def _import(name: str) -> Adapter:
    if name in _DISTRIBUTIONS and installed(_DISTRIBUTIONS[name]) is None:
        raise UnavailableError(f"{name} is not installed: {_remedy(name)}")
    try:
        if name in _BUILT_IN:
            module, attribute = _BUILT_IN[name]
            make = getattr(importlib.import_module(module), attribute)
        else:
            make = _plugged_in()[name].load() if name in _plugged_in() else stated_by(name)
        adapter: Adapter = make()
    except Exception as error:  # an engine's module may raise anything
        what = error if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"
        raise UnavailableError(f"{name} cannot be imported: {what}") from error
    if missing := [part for part in _CONTRACT if not hasattr(adapter, part)]:
        raise UnavailableError(f"{name} is not an adapter: it has no {', no '.join(missing)}")
    return adapter
