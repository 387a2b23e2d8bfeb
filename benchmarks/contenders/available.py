"""Which contenders can be measured here; those that cannot are named with the reason."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.contenders.closed_form import CLOSED_FORM, CLOSED_FORM_SET_UP_BEFORE
from benchmarks.contenders.contender import Contender
from benchmarks.contenders.engine import engine_contender
from benchmarks.contenders.scipy_dop853 import scipy_dop853
from benchmarks.contenders.stepped_taylor import STEPPED_TAYLOR
from bodycheck.adapters.mujoco import MuJoCo
from bodycheck.adapters.reference import Reference

_MAX_STEPS = 1 << 15

MUJOCO, SCIPY, HEYOKA = "MuJoCo rk4", "scipy DOP853", "heyoka Taylor"


@dataclass(frozen=True)
class Field:
    """The contenders for a problem, and the reasons why others are missing, by name."""

    contenders: tuple[Contender, ...]
    missing: dict[str, str]

    def only(self, *names: str) -> Field:
        """Return those of the names given."""
        return Field(
            tuple(one for one in self.contenders if one.name in names),
            {name: why for name, why in self.missing.items() if name in names},
        )

    def without(self, *names: str) -> Field:
        """Return all but those of the names given."""
        return self.only(*{one.name for one in self.contenders} - {*names}, *self.missing.keys() - {*names})


def whole_field() -> Field:
    """Return every contender: ours, the reference's fixed steps, MuJoCo, scipy, heyoka if installed."""
    contenders = [
        CLOSED_FORM,
        CLOSED_FORM_SET_UP_BEFORE,
        STEPPED_TAYLOR,
        engine_contender("reference rk4", Reference(), "rk4", 8, _MAX_STEPS),
        engine_contender("reference dop853", Reference(), "dop853", 8, _MAX_STEPS),
        engine_contender(MUJOCO, MuJoCo(), "rk4", 8, _MAX_STEPS),
        scipy_dop853(),
    ]
    try:
        from benchmarks.contenders.heyoka_taylor import heyoka_taylor
    except ImportError as error:
        return Field(tuple(contenders), {HEYOKA: f"heyoka cannot be imported: {error}"})
    return Field((*contenders, heyoka_taylor()), {})
