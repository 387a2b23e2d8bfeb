"""Faults of the one-step map: missing and additional terms, damping."""

from __future__ import annotations

import math
from collections.abc import Iterator

from bodycheck.examine.diagnosis.candidate_maps import ATTITUDE_STEPS, EXACT
from bodycheck.examine.diagnosis.faults.fault import (
    FACTOR,
    Fault,
    Parameter,
    assigned,
    constant,
    constant_and_first,
    near,
)

_RATE = Parameter("rate", "1/s", 0.0)


def map_faults() -> Iterator[Fault]:
    """Yield the faults of the one-step map."""
    yield Fault(
        "gyroscopic-term",
        "map",
        "the gyroscopic term omega x I omega is multiplied by {0}",
        assigned("gyro"),
        (FACTOR,),
        near(1.0, 0.0, -1.0),
        lambda at: at.rotates,
        (
            (0.0, "the gyroscopic term omega x I omega is missing"),
            (-1.0, "the gyroscopic term omega x I omega has the wrong sign"),
        ),
        confirm="spin a free body off its principal axes: omega in body axes must change at the rate "
        "and with the sign of Euler's equations, I omega' = I omega x omega",
    )
    yield Fault(
        "omega-in-wrong-axes",
        "map",
        "omega rotates the attitude in the wrong axes: q+ = exp(dt omega / 2) q with omega in body axes",
        constant(world_turn=1.0),
        applies=lambda at: at.rotates,
        confirm="start the same motion from another attitude: the error must change",
    )
    yield Fault(
        "velocity-in-body-axes",
        "map",
        "the velocity rotates with the body: v' has the term omega x v",
        constant(body_velocity=1.0),
        applies=lambda at: at.rotates and at.shows_translation,
        confirm="boost the scene by a velocity: the error must change",
    )
    yield Fault(
        "energy-pulled",
        "map",
        "the energy is pulled towards L^2 / (2 I2) at {0} 1/s, |L| unchanged",
        assigned("energy_pull"),
        (_RATE,),
        near(0.0, 1.0),
        lambda at: at.rotates,
        confirm="let the free body rotate for a long time: its energy must approach L^2 / (2 I2)",
    )
    yield Fault(
        "damping-angular",
        "map",
        "omega is damped at the rate {0} 1/s",
        assigned("damping_w"),
        (_RATE,),
        near(0.0, 1.0),
        lambda at: at.rotates,
        confirm="spin the body about a principal axis and wait",
    )
    yield Fault(
        "damping-torque",
        "map",
        "a damping torque of -{0} N m s times omega acts on the body",
        assigned("damping_torque"),
        (Parameter("coefficient", "N m s", 0.0),),
        near(0.0, 1.0),
        lambda at: at.rotates,
        confirm="spin the body about two principal axes and wait: the rates must be c over the moments",
    )
    yield Fault(
        "damping-linear",
        "map",
        "the velocity is damped at the rate {0} 1/s",
        assigned("damping_v"),
        (_RATE,),
        near(0.0, 1.0),
        lambda at: at.shows_translation,
        confirm="let the body fly without gravity",
    )
    yield Fault(
        "damping",
        "map",
        "the velocity and omega are damped at the rate {0} 1/s",
        assigned("damping_v", "damping_w"),
        (_RATE,),
        near(0.0, 1.0),
        lambda at: at.rotates and at.shows_translation,
        confirm="let the body fly and spin about a principal axis",
    )
    yield Fault(
        "damping-bullet",
        "map",
        "the velocity and omega are damped as by Bullet's multi-body, v' = -d (1 + |v|) v with d = {0} 1/s",
        assigned("damping_v", "damping_v_speed", "damping_w", "damping_w_speed"),
        (Parameter("damping", "1/s", 0.0, size=0.1),),
        near(0.0),
        confirm="set linearDamping and angularDamping to 0 and run the case again",
    )
    yield Fault(
        "damping-quadratic-angular",
        "map",
        "omega is damped by {0} |omega| omega",
        assigned("damping_w_speed"),
        (Parameter("coefficient", "", 0.0),),
        near(0.0),
        lambda at: at.rotates,
        confirm="spin the body about a principal axis at two speeds",
    )
    yield Fault(
        "damping-quadratic-linear",
        "map",
        "the velocity is damped by {0} |v| v",
        assigned("damping_v_speed"),
        (Parameter("coefficient", "1/m", 0.0),),
        near(0.0),
        lambda at: at.shows_translation,
        confirm="let the body fly at two speeds",
    )
    for noun, quantity, name in (("omega", "w", "angular"), ("the velocity", "v", "linear")):
        for late, when in ((False, "kick"), (True, "step")):
            yield Fault(
                f"damping-{name}-after-{when}",
                "map",
                f"{noun} is multiplied by 1 - dt {{0}}/s after each {when}",
                constant_and_first({"slowed_late": late}, f"slowed_{quantity}"),
                (_RATE,),
                near(0.0, 1.0),
                (lambda at: at.stepped and at.rotates)
                if quantity == "w"
                else (lambda at: at.stepped and at.shows_translation),
                confirm="spin the body about a principal axis and wait, at two steps",
            )
    yield Fault(
        "attitude-rate-scaled",
        "map",
        "the attitude advances with omega multiplied by {0}",
        assigned("turn_factor"),
        (FACTOR,),
        near(1.0, math.pi / 180.0, 180.0 / math.pi, 2.0, 0.5, 0.0, -1.0),
        lambda at: at.rotates,
        (
            (0.0, "the attitude does not advance"),
            (-1.0, "the attitude advances with omega of the opposite sign"),
            (
                2.0,
                "the attitude advances twice as fast as omega: the factor 1/2 of q' = q omega / 2 is missing",
            ),
            (0.5, "the attitude advances half as fast as omega"),
            (math.pi / 180.0, "the attitude advances with omega taken as degrees per second"),
            (180.0 / math.pi, "the attitude advances with omega in degrees per second"),
        ),
        confirm="compare omega with the derivative of the attitude",
    )
    for place, (formula, *_) in enumerate(ATTITUDE_STEPS, start=1):
        yield Fault(
            f"attitude-step-{place}",
            "map",
            f"the attitude is not advanced by the method of omega, but by {formula}",
            constant(attitude_step=float(place)),
            applies=lambda at: at.rotates and at.base.tableau is not None and at.base is not EXACT,
            confirm="rotate about a principal axis: an exact step of the attitude errs by round-off alone",
        )
    yield Fault(
        "position-by-old-velocity",
        "map",
        "the position advances with the velocity at the start of the step",
        constant(old_velocity=1.0),
        applies=lambda at: at.shows_translation,
        confirm="drop the body from rest: its first step must not move it",
    )
