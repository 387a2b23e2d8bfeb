"""Import users' functions named package.module:function; this runs code, so the user must allow it."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bodycheck._util.code_gate import check_code
from bodycheck._util.errors import InputError
from bodycheck.reference_impl.arrays import Array

_NAME = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*:[^\W\d]\w*")


def user_function(name: str, *, allow_code: bool, file: Path | None = None) -> Callable[..., Any]:
    """Import package.module:function; the working directory comes last on the path.

    allow_code, file: as for `check_code`. Raises InputError with one line if code is not allowed, the name is
    invalid, the import fails, or the object is not callable.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"{name}: not the name of a function (expected package.module:function)")
    check_code(name, "importing it runs its code", allow_code=allow_code, file=file)
    module_name, _, function_name = name.partition(":")
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)  # last: no file there may replace an installed package
    try:
        module = importlib.import_module(module_name)
    except (Exception, SystemExit) as error:
        raise InputError(f"{name}: cannot be imported: {error_text(error)}") from error
    function = getattr(module, function_name, None)
    if not callable(function):
        raise InputError(f"{name}: {module_name} has no function {function_name!r}")
    return function


@dataclass(frozen=True)
class UserWrench:
    """f(t, position, R, velocity, omega) -> force, torque: a user's function; world axes, SI units.

    position, velocity, omega, force and torque are (3,), R is (3, 3).
    """

    name: str
    function: Callable[..., Any]

    def __call__(
        self, t: float, position: Array, rotation: Array, velocity: Array, omega: Array
    ) -> tuple[Array, Array]:
        """Call the function with copies, which it may modify; return force (3,) and torque (3,).

        Raises InputError with one line if the function raises or does not return two triples of finite
        numbers.
        """
        copies = (part.copy() for part in (position, rotation, velocity, omega))
        try:
            found = self.function(t, *copies)
        except (Exception, SystemExit) as error:
            raise InputError(f"{self.name}: failed at t = {t!r} s: {error_text(error)}") from error
        try:
            force, torque = (np.asarray(part, dtype=np.float64) for part in found)
        except (TypeError, ValueError):
            force = torque = np.zeros(0)
        if force.shape != (3,) or torque.shape != (3,) or not np.isfinite([force, torque]).all():
            text = " ".join(repr(found).split())
            raise InputError(
                f"{self.name}: must return force and torque, three finite numbers each, "
                f"not {text:.80} (t = {t!r} s)"
            )
        return force, torque


def error_text(error: BaseException) -> str:
    """Return an exception's type and message in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
