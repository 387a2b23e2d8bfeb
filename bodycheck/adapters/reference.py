"""The from-scratch reference as an engine: its fixed-step integrators, its closed form, its Taylor series."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version

from bodycheck.adapters.contract import Method, ReadBack, Reading, Simulation, Solver
from bodycheck.adapters.reference_steps import FixedStep
from bodycheck.reference_impl.exact import closed_form_of
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.integrators.asking import can_ask
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.scene import GravityGradient, Scene
from bodycheck.reference_impl.taylor_motion import TaylorMotion
from bodycheck.reference_impl.trajectory import Trajectory

_EXACT = Method(
    name="exact",
    formula="q and omega at any t without stepping: Jacobi's elliptic functions, or about a fixed axis",
    order=None,
    evaluations=None,
    torque="in closed form",
    lasting="in closed form",
    keeps="everything, to round-off",
    source="Jacobi (1849); van Zon and Schofield (2007), J. Comput. Phys. 225, 145",
    control="none",
)

_TAYLOR = Method(
    name="taylor",
    formula="q, omega, v and x by their Taylor series, each step as long as its last terms allow",
    order=None,
    evaluations=None,
    torque="every stage",
    lasting="every stage",
    keeps="everything, to the tolerance a step",
    source="Jorba and Zou (2005), Experimental Mathematics 14, 99",
    control="tolerance",
    tolerances=(1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 1e-16),
)

_NO_CLOSED_FORM = "no closed form for this body, this start and these loads"
_NO_SERIES = "a load that only a function knows has no Taylor series"


def _method_of(integrator: Integrator) -> Method:
    return Method(
        name=integrator.name,
        formula=integrator.formula,
        order=integrator.order,
        evaluations=integrator.evaluations,
        torque=integrator.torque,
        lasting=integrator.lasting,
        keeps=integrator.keeps,
        source=integrator.source,
    )


class ClosedForm:
    """A scene by its exact solution: set up once when built, then any sample at the same cost."""

    steps: int | None = None

    def __init__(self, scene: Scene) -> None:
        motion = closed_form_of(scene)
        if motion is None:
            raise ValueError(_NO_CLOSED_FORM)
        self._scene, self._motion = scene, motion

    def read_back(self) -> ReadBack:
        """Return the scene's own numbers: there is no engine between."""
        return _own_numbers(self._scene)

    def solve(self) -> Trajectory:
        """Solve for all samples in one call."""
        return self._motion.at(self._scene.sample_times)

    def close(self) -> None:
        """Nothing to free."""


class Series:
    """A scene by the Taylor integrator: packed once when built, its samples from the series' dense output."""

    steps: int | None = None

    def __init__(self, scene: Scene, tolerance: float) -> None:
        self._scene, self._motion = scene, TaylorMotion.of(scene, tolerance)

    def read_back(self) -> ReadBack:
        """Return the scene's own numbers: there is no engine between."""
        return _own_numbers(self._scene)

    def solve(self) -> Trajectory:
        """Follow the motion through all samples."""
        solved = self._motion.solve(self._scene.sample_times)
        self.steps = solved.steps
        return solved.trajectory

    def close(self) -> None:
        """Nothing to free."""


class Reference:
    """The reference as one engine among the others."""

    name = "reference"

    def __init__(self) -> None:
        self.version = version("bodycheck")
        self.methods: Mapping[str, Method] = {
            _EXACT.name: _EXACT,
            _TAYLOR.name: _TAYLOR,
            **{name: _method_of(integrator) for name, integrator in INTEGRATORS.items()},
        }

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Say what a method is not for; a link frame means nothing where no engine is between."""
        if method == _EXACT.name:
            return _NO_CLOSED_FORM if scene.has_black_box or closed_form_of(scene) is None else None
        if method == _TAYLOR.name:
            return _NO_SERIES if scene.has_black_box else None
        if scene.has_black_box and not can_ask(INTEGRATORS[method]):
            return f"{method} takes the loads of its stages from compiled code, which can ask no function"
        kinds = {type(load) for load in scene.lasting_loads}
        if scene.pivot is not None and GravityGradient in kinds:
            return "a gravity gradient is reduced to no torque about a pivot"
        refused = [kind.__name__.lower() for kind in INTEGRATORS[method].refused if kind in kinds]
        return f"{method} steps no {', '.join(refused)}: its kicks must be exact" if refused else None

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Return a stepper of the scene."""
        return FixedStep(scene, INTEGRATORS[method], dt_s)

    def solver(self, scene: Scene, method: str, tolerance: float | None) -> Solver:
        """Return the closed form of the scene, or its Taylor series."""
        if method == _EXACT.name:
            return ClosedForm(scene)
        assert tolerance is not None
        return Series(scene, tolerance)


def _own_numbers(scene: Scene) -> ReadBack:
    """Return what a solver without an engine between holds: the scene itself."""
    body, initial = scene.body, scene.initial
    start = Reading(
        position=initial.position,
        velocity=initial.velocity,
        quaternion=initial.quaternion,
        omega_body=initial.omega_body,
    )
    return ReadBack(body.mass, body.inertia, None, scene.gravity, start)
