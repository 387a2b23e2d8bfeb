"""Slips in the classical Runge-Kutta method as it is written by hand: stages and weights."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from bodycheck.examine.diagnosis.candidate_maps import RK4
from bodycheck.examine.diagnosis.engine_model import Model
from bodycheck.examine.diagnosis.faults.fault import Fault, FaultContext, Parameter, Plant, near
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.facts import Tableau

_WEIGHT_CHANGES = 100.0  # a step is linear in its weights, whose slopes differ by little
_NTH = ("first", "second", "third", "last")
_CONFIRM = "compare each stage and weight with k1 at 0, k2 and k3 at dt/2, k4 at dt, and 1/6, 1/3, 1/3, 1/6"


def tableau_faults() -> Iterator[Fault]:
    """Yield the slips of one stage, then those of the weights."""
    for stage, right in ((1, 0.5), (2, 0.5), (3, 1.0)):
        where = f"the {_NTH[stage]} stage is evaluated at {{}} of the step, not at its {_place(right)}"
        yield _slip(
            f"stage-{stage + 1}-misplaced",
            where.format("{0}"),
            _with_row(stage, stage - 1),
            Parameter("place", healthy=right),
            special=tuple((at, where.format(f"the {_place(at)}")) for at in (0.0, 0.5, 1.0) if at != right),
            starts=(1.5 - right,),
        )
    for stage, other in ((2, 0), (3, 0), (3, 1)):
        text = f"the {_NTH[stage]} stage starts with the slope of the {_NTH[other]} one"
        yield _slip(f"stage-{stage + 1}-from-{other + 1}", text, _with_row(stage, other))
    for text, weights in (
        ("equal: 1/4 each", (1 / 4, 1 / 4, 1 / 4, 1 / 4)),
        ("exchanged: 1/3, 1/6, 1/6, 1/3", (1 / 3, 1 / 6, 1 / 6, 1 / 3)),
        ("1/6 each: the factors 2 are missing", (1 / 6, 1 / 6, 1 / 6, 1 / 6)),
    ):
        name = f"weights-{text.partition(':')[0].replace('/', '-').replace(' ', '-')}"
        yield _slip(name, f"the weights of the stages are {text}", _with_weights(weights))
    for stage, right in enumerate(RK4.b):
        text = f"the weight of the {_NTH[stage]} stage is {{}}, not {'1/3' if 0 < stage < 3 else '1/6'}"
        yield _slip(
            f"weight-{stage + 1}",
            text.format("{0}"),
            _with_weight(stage),
            Parameter("weight", healthy=float(right)),
            special=(
                (0.0, text.format("0")),
                (0.5 - float(right), text.format("1/6" if 0 < stage < 3 else "1/3")),
            ),
            starts=(0.0,),
        )
    yield replace(
        _slip(
            "weights",
            "the weights of the stages are {0}, {1}, {2} and {3}, not 1/6, 1/3, 1/3 and 1/6",
            _any_weights,
            *(
                Parameter(f"weight of the {nth} stage", healthy=b, size=_WEIGHT_CHANGES)
                for nth, b in zip(_NTH, RK4.b, strict=True)
            ),
        ),
        starts=lambda _: [tuple(RK4.b)],
        is_general=True,
        is_flexible=True,
    )


def _slip(
    name: str,
    text: str,
    plant: Plant,
    *parameters: Parameter,
    special: tuple[tuple[float, str], ...] = (),
    starts: tuple[float, ...] = (),
) -> Fault:
    return Fault(
        name,
        "map",
        text,
        plant,
        parameters,
        near(*starts) if parameters else lambda _: [()],
        lambda at: at.rotates and at.base.is_rk4,
        special,
        confirm=_CONFIRM,
    )


def _place(share: float) -> str:
    return {0.0: "start", 0.5: "middle", 1.0: "end"}[share]


def _with_row(stage: int, other: int) -> Plant:
    """Return what starts a stage with the slope of another one, at the first parameter if there is one."""

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        old = model.tableau or RK4
        a = old.a.copy()
        a[stage] = 0.0
        a[stage, other] = values[0] if len(values) else old.c[stage]
        model.tableau = Tableau(a, old.b, a.sum(axis=1))

    return plant


def _with_weights(weights: tuple[float, ...]) -> Plant:
    def plant(model: Model, values: Array, at: FaultContext) -> None:
        model.tableau = (model.tableau or RK4)._replace(b=np.array(weights))

    return plant


def _any_weights(model: Model, values: Array, at: FaultContext) -> None:
    model.tableau = (model.tableau or RK4)._replace(b=values)


def _with_weight(stage: int) -> Plant:
    """Return what assigns the first parameter to a weight."""

    def plant(model: Model, values: Array, at: FaultContext) -> None:
        old = model.tableau or RK4
        b = old.b.copy()
        b[stage] = values[0]
        model.tableau = old._replace(b=b)

    return plant
