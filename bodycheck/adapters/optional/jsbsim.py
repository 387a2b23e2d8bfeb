"""JSBSim: a vehicle without aerodynamics above a planet without gravity or rotation, by its integrators.

JSBSim's foot, slug and pound stand for m, kg and N. The body starts level at latitude and longitude 0: the
world is JSBSim's inertial frame, shifted and turned so that position and attitude are those of the scene.
Gravity is an external force, like all loads. JSBSim first makes a step with the accelerations of the last
state and then computes those of the next, so loads are renewed at the present state by a run without time.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading, Simulation, Stepping
from bodycheck.adapters.optional.between_steps import FreeBodiesOnly, array
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import PointForce, Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench

_EULER, _TRAPEZOIDAL, _AB2, _AB3, _AB4, _BUSS1, _BUSS2, _LINEARISED = 1, 2, 3, 4, 5, 6, 7, 8
_M1 = "M1, pose from the old omega, additive quaternion renormalised"
_OMEGA = "Adams-Bashforth 2 for omega"
_INTEGRATORS = {
    "default": (
        (_EULER, _EULER, _AB2, _AB3),
        1,
        "M1, pose from the old omega, additive quaternion renormalised",
    ),
    "trapezoidal": ((_TRAPEZOIDAL,) * 4, 1, "y+ = y + dt (y' + y'_last) / 2, y = (omega, q)"),
    "adams-bashforth2": ((_AB2,) * 4, 2, "Adams-Bashforth 2 for omega and q"),
    "adams-bashforth3": ((_AB3,) * 4, 2, "Adams-Bashforth 3 for omega and q"),
    "adams-bashforth4": ((_AB4,) * 4, 2, "Adams-Bashforth 4 for omega and q"),
    "buss1": ((_AB2, _BUSS1, _AB2, _AB2), 1, "Adams-Bashforth 2 for omega; q by Buss (2000), order 1"),
    "buss2": ((_AB2, _BUSS2, _AB2, _AB2), 2, "Adams-Bashforth 2 for omega; q by Buss (2000), order 2"),
    "linearised": (
        (_AB2, _LINEARISED, _AB2, _AB2),
        2,
        "Adams-Bashforth 2 for omega; q by local linearisation",
    ),
}
"""Integrators of omega, attitude, velocity and position; order; formula."""
_PLACES = ("rate/rotational", "position/rotational", "rate/translational", "position/translational")
_RADIUS = 100.0
"""Small, because positions are rounded relative to it."""
_SLUG_LBS = 32.174049
_TURNED = (-1.0, 1.0, -1.0)
"""Axes of the structural frame, x aft and z up, in body axes."""
_PLANET = f"""<?xml version="1.0"?>
<planet name="none"><equatorial_radius unit="FT">{_RADIUS}</equatorial_radius>
<polar_radius unit="FT">{_RADIUS}</polar_radius><GM unit="FT3/SEC2">1e-300</GM><J2>0</J2>
<rotation_rate unit="RAD/SEC">0</rotation_rate></planet>"""


def _method_of(name: str) -> Method:
    numbers, order, formula = _INTEGRATORS[name]
    settings = "; ".join(
        f"fdm['simulation/integrator/{place}'] = {number}"
        for place, number in zip(_PLACES, numbers, strict=True)
    )
    return Method(
        name=name,
        formula=formula,
        order=order,
        evaluations=1,
        torque="zero-order hold",
        conserves="|q| = 1; linear momentum",
        source="JSBSim, FGPropagate.cpp",
        changed_defaults=("a planet without gravity and rotation", "no aerodynamics or ground")
        + (() if name == "default" else ("integrators",)),
        snippet=f"fdm.set_dt({{dt_s}}); {settings}",
    )


class JSBSim(FreeBodiesOnly):
    """JSBSim (Berndt and the JSBSim team)."""

    name = "jsbsim"
    distribution = "jsbsim"
    requires = ("jsbsim>=1.2.1",)
    modules = ("jsbsim",)
    methods: Mapping[str, Method] = {name: _method_of(name) for name in _INTEGRATORS}

    def __init__(self) -> None:
        os.environ.setdefault("JSBSIM_DEBUG", "0")
        super().__init__()

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Refuse loads that vary with time or motion, too."""
        if scene.continuous_loads:
            return "an external force that a program changes at every step acts one step late"
        return super().unsupported(scene, method)

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a vehicle of a mass alone."""
        return _Vehicle(scene, method, dt_s)


class _Vehicle:
    stepping: Stepping = "python"

    def __init__(self, scene: Scene, method: str, dt_s: float) -> None:
        import jsbsim

        self._scene = scene
        points = {
            tuple(load.at)
            for load in scene.loads
            if isinstance(load, PointForce) and load.axes == "world" and np.any(load.at)
        }
        self._points: list[tuple[float, ...]] = sorted(points)
        with TemporaryDirectory() as folder:
            aircraft = Path(folder, "aircraft", "body")
            aircraft.mkdir(parents=True)
            (aircraft / "body.xml").write_text(_vehicle_xml(scene, self._points))
            Path(folder, "planet.xml").write_text(_PLANET)
            self._fdm: Any = jsbsim.FGFDMExec(folder)
            self._fdm.set_debug_level(0)
            self._fdm.load_model("body")
            self._fdm.load_planet(str(Path(folder, "planet.xml")), False)
        self._fdm.set_dt(dt_s)
        for place, number in zip(_PLACES, _INTEGRATORS[method][0], strict=True):
            self._fdm[f"simulation/integrator/{place}"] = number
        self._fdm["simulation/gravity-model"] = 0
        self.reset()

    def reset(self) -> None:
        """Restore the initial state at t = 0, without a wrench."""
        self._steps_made = 0
        self.apply(NO_WRENCH)

    def _start(self) -> None:
        start, fdm = self._scene.initial, self._fdm
        values = {"lat-geod-deg": 0.0, "long-gc-deg": 0.0, "h-sl-ft": _RADIUS}
        values |= dict.fromkeys(("psi-true-deg", "theta-deg", "phi-deg"), 0.0)
        values |= dict(zip(("u-fps", "v-fps", "w-fps"), start.rotation.T @ start.velocity, strict=True))
        values |= dict(zip(("p-rad_sec", "q-rad_sec", "r-rad_sec"), start.omega_body, strict=True))
        for name, value in values.items():
            fdm[f"ic/{name}"] = float(value)
        fdm.run_ic()
        self._turn = start.rotation @ array(fdm.get_propagate().get_Tec2b())
        self._origin = self._vector("position/ecef-{}-ft")

    def apply(self, wrench: Wrench) -> None:
        """Replace the constant loads, and compute the accelerations of the present state."""
        scene = self._scene
        if self._steps_made == 0:
            self._start()
        self._set("weight", self._turn.T @ (scene.body.mass * scene.gravity))
        self._set("fw", self._turn.T @ wrench.force_world)
        self._set("fb", wrench.force_body)
        self._set("mw", self._turn.T @ wrench.torque_world, moment=True)
        self._set("mb", wrench.torque_body, moment=True)
        sums = {point: np.zeros(3) for point in self._points}
        for at, force in wrench.point_forces:
            sums[tuple(at)] = sums[tuple(at)] + force
        for number, point in enumerate(self._points):
            self._set(f"p{number}", self._turn.T @ sums[point])
        if self._steps_made == 0:
            self._fdm.run_ic()
        else:
            self._fdm.suspend_integration()
            self._fdm.run()
            self._fdm.resume_integration()

    def _set(self, name: str, value: Array, *, moment: bool = False) -> None:
        size = float(np.linalg.norm(value))
        direction = value / size if size else np.array([1.0, 0.0, 0.0])
        for axis, part in zip("lmn" if moment else "xyz", direction, strict=True):
            self._fdm[f"external_reactions/{name}/{axis}"] = float(part)
        self._fdm[f"external_reactions/{name}/magnitude{'-lbsft' if moment else ''}"] = size

    def advance(self, steps: int) -> None:
        """Make the steps, one call each."""
        for _ in range(steps):
            self._fdm.run()
        self._steps_made += steps

    def read(self) -> Reading:
        """Return copies of the state; the attitude as a matrix."""
        rotation = self._turn @ array(self._fdm.get_propagate().get_Tec2b()).T
        position = self._turn @ (self._vector("position/ecef-{}-ft") - self._origin)
        return Reading(
            self._scene.initial.position + position,
            rotation @ self._vector("velocities/{}-fps", "uvw"),
            rotation=rotation,
            omega_body=self._vector("velocities/{}-rad_sec", "pqr"),
        )

    def _vector(self, name: str, axes: Iterable[str] = "xyz") -> Array:
        return np.array([self._fdm[name.format(axis)] for axis in axes])

    def read_back(self) -> ReadBack:
        """Return the model and the state as JSBSim holds them."""
        inertia = np.zeros((3, 3))
        for i, j, name in (
            (0, 0, "xx"),
            (1, 1, "yy"),
            (2, 2, "zz"),
            (0, 1, "xy"),
            (0, 2, "xz"),
            (1, 2, "yz"),
        ):
            value = self._fdm[f"inertia/i{name}-slugs_ft2"]
            inertia[i, j] = inertia[j, i] = value * _TURNED[i] * _TURNED[j]
        mass = self._fdm["inertia/mass-slugs"]
        weight = self._fdm["external_reactions/weight/magnitude"] * self._vector(
            "external_reactions/weight/{}"
        )
        return ReadBack(mass, inertia, self._fdm.get_delta_t(), self._turn @ weight / mass, self.read())

    def close(self) -> None:
        """Do nothing; JSBSim is freed with this object."""


def _vehicle_xml(scene: Scene, points: Iterable[tuple[float, ...]]) -> str:
    """Return the file of a mass with external forces and moments; its structural frame is x aft, z up."""
    inertia = scene.body.inertia.tolist()
    zero = '<location unit="FT"><x>0</x><y>0</y><z>0</z></location>'
    ahead = "<direction><x>1</x><y>0</y><z>0</z></direction>"
    loads = [
        f'<force name="weight" frame="INERTIAL">{zero}{ahead}</force>',
        f'<force name="fw" frame="INERTIAL">{zero}{ahead}</force>',
        f'<force name="fb" frame="BODY">{zero}{ahead}</force>',
        f'<moment name="mw" frame="INERTIAL">{ahead}</moment>',
        f'<moment name="mb" frame="BODY">{ahead}</moment>',
    ]
    for number, (x, y, z) in enumerate(points):
        at = f'<location unit="FT"><x>{-float(x)!r}</x><y>{float(y)!r}</y><z>{-float(z)!r}</z></location>'
        loads.append(f'<force name="p{number}" frame="INERTIAL">{at}{ahead}</force>')
    return f"""<?xml version="1.0"?>
<fdm_config name="body" version="2.0" release="ALPHA">
<metrics><wingarea unit="FT2">1</wingarea><wingspan unit="FT">1</wingspan><chord unit="FT">1</chord>
<location name="AERORP" unit="FT"><x>0</x><y>0</y><z>0</z></location></metrics>
<mass_balance negated_crossproduct_inertia="false">
<ixx unit="SLUG*FT2">{inertia[0][0]!r}</ixx><iyy unit="SLUG*FT2">{inertia[1][1]!r}</iyy>
<izz unit="SLUG*FT2">{inertia[2][2]!r}</izz><ixy unit="SLUG*FT2">{inertia[0][1]!r}</ixy>
<ixz unit="SLUG*FT2">{-inertia[0][2]!r}</ixz><iyz unit="SLUG*FT2">{inertia[1][2]!r}</iyz>
<emptywt unit="LBS">{float(scene.body.mass) * _SLUG_LBS!r}</emptywt>
<location name="CG" unit="FT"><x>0</x><y>0</y><z>0</z></location></mass_balance>
<ground_reactions/><propulsion/><flight_control name="none"/><aerodynamics/>
<external_reactions>{"".join(loads)}</external_reactions>
</fdm_config>"""
