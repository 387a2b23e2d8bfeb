"""The same free body in each optional engine through its own API, without bodycheck, to check the adapters.

python engine_drivers.py ENGINE METHOD prints the last state as JSON: quaternion (w, x, y, z) or rotation
matrix, and omega in world axes or in body axes. The body has I = diag(1, 2, 3) kg m^2 and 1 kg, starts with
omega = (0.1, 2, 0.1) rad/s, and makes 100 steps of 1e-2 s without loads.
"""

from __future__ import annotations

import json
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

MOMENTS, OMEGA, DT, STEPS = (1.0, 2.0, 3.0), (0.1, 2.0, 0.1), 1e-2, 100


def rapier(method: str) -> dict[str, Any]:
    """Step a body of a PhysicsWorld."""
    import rapier3d as r

    world = r.PhysicsWorld()
    world.integration_parameters.dt = DT
    solid = r.MassProperties(r.Vec3(0, 0, 0), 1.0, r.Vec3(*MOMENTS), r.Rotation3.identity())
    body = r.RigidBody.dynamic().additional_mass_properties(solid).angvel(r.Vec3(*OMEGA))
    if "@" not in method:
        body = body.gyroscopic_forces(True)
    handle = world.add_body(body)
    for _ in range(STEPS):
        world.step()
    held = world.rigid_bodies[handle]
    turn = held.rotation
    return {"quaternion": [turn.w, turn.i, turn.j, turn.k], "omega_world": list(held.angvel.to_tuple())}


def drake(method: str) -> dict[str, Any]:
    """Step a MultibodyPlant of one body."""
    from pydrake.all import (
        DiagramBuilder,
        MultibodyPlant,
        ResetIntegratorFromFlags,
        Simulator,
        SpatialInertia,
        UnitInertia,
    )

    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(DT if method == "discrete" else 0.0))
    plant.AddRigidBody("b", SpatialInertia(1.0, np.zeros(3), UnitInertia(*MOMENTS)))
    plant.mutable_gravity_field().set_gravity_vector(np.zeros(3))
    plant.Finalize()
    simulator = Simulator(builder.Build())
    if method != "discrete":
        ResetIntegratorFromFlags(simulator, method.replace("-", "_"), DT).set_fixed_step_mode(True)
    context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    plant.SetPositions(context, [1, 0, 0, 0, 0, 0, 0])
    plant.SetVelocities(context, [*OMEGA, 0, 0, 0])
    simulator.AdvanceTo(STEPS * DT)
    q, v = plant.GetPositions(context), plant.GetVelocities(context)
    return {"quaternion": q[:4].tolist(), "omega_world": v[:3].tolist()}


def pinocchio(method: str) -> dict[str, Any]:
    """Write the loop around aba and integrate."""
    import pinocchio as pin

    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "ff")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.diag(MOMENTS)), pin.SE3.Identity())
    model.gravity = pin.Motion.Zero()
    data, none = model.createData(), np.zeros(6)
    q, v = np.array([0.0, 0, 0, 0, 0, 0, 1]), np.array([0.0, 0, 0, *OMEGA])

    def rate(q: Any, v: Any) -> Any:
        return pin.aba(model, data, q, v, none).copy()

    for _ in range(STEPS):
        if method == "semi-implicit":
            v = v + DT * rate(q, v)
            q = pin.integrate(model, q, DT * v)
            continue
        v1, a1 = v, rate(q, v)
        v2 = v + 0.5 * DT * a1
        a2 = rate(pin.integrate(model, q, 0.5 * DT * v1), v2)
        v3 = v + 0.5 * DT * a2
        a3 = rate(pin.integrate(model, q, 0.5 * DT * v2), v3)
        v4 = v + DT * a3
        a4 = rate(pin.integrate(model, q, DT * v3), v4)
        q = pin.integrate(model, q, DT / 6.0 * (v1 + 2 * v2 + 2 * v3 + v4))
        v = v + DT / 6.0 * (a1 + 2 * a2 + 2 * a3 + a4)
    return {"quaternion": [q[6], *q[3:6]], "omega_body": v[3:].tolist()}


def _euler_equations(y: Any) -> list[Any]:
    w, x, y_, z, a, b, c = y
    return [
        0.5 * (-x * a - y_ * b - z * c),
        0.5 * (w * a + y_ * c - z * b),
        0.5 * (w * b + z * a - x * c),
        0.5 * (w * c + x * b - y_ * a),
        -b * c,
        a * c,
        -a * b / 3.0,
    ]


def scipy(method: str) -> dict[str, Any]:
    """Solve Euler's equations with solve_ivp."""
    from scipy.integrate import solve_ivp

    called = {"dop853": "DOP853", "radau": "Radau", "lsoda": "LSODA"}[method]
    found = solve_ivp(
        lambda _, y: _euler_equations(y),
        (0, STEPS * DT),
        [1, 0, 0, 0, *OMEGA],
        called,
        rtol=1e-12,
        atol=1e-12,
    )
    return {"quaternion": found.y[:4, -1].tolist(), "omega_body": found.y[4:, -1].tolist()}


def heyoka(_: str) -> dict[str, Any]:
    """Propagate Euler's equations."""
    import heyoka as hy

    held = hy.make_vars("w", "x", "y", "z", "a", "b", "c")
    equations = list(zip(held, _euler_equations(held), strict=True))
    integrator = hy.taylor_adaptive(equations, [1.0, 0, 0, 0, *OMEGA], tol=1e-12)
    integrator.propagate_until(STEPS * DT)
    return {"quaternion": integrator.state[:4].tolist(), "omega_body": integrator.state[4:].tolist()}


def newton(method: str) -> dict[str, Any]:
    """Step one state into another."""
    import newton as nt
    import warp

    warp.config.quiet = True
    builder = nt.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    builder.add_body(mass=1.0, inertia=warp.mat33(*np.diag(MOMENTS).ravel().tolist()), lock_inertia=True)
    model = builder.finalize(device="cpu")
    kind, _, variant = method.partition("@")
    undamped = {} if variant else {"angular_damping": 0.0}
    if kind.startswith("mujoco-"):
        solver = nt.solvers.SolverMuJoCo(model, integrator=kind.removeprefix("mujoco-"))
    elif kind == "xpbd":
        solver = nt.solvers.SolverXPBD(model)
    else:
        called = {
            "semi-implicit": nt.solvers.SolverSemiImplicit,
            "featherstone": nt.solvers.SolverFeatherstone,
        }
        solver = called[kind](model, **undamped)
    one, other = model.state(), model.state()
    one.joint_qd.assign(np.array([0, 0, 0, *OMEGA], dtype=np.float32))
    nt.eval_fk(model, one.joint_q, one.joint_qd, one)
    for _ in range(STEPS):
        solver.step(one, other, None, None, DT)
        one, other = other, one
    pose, rates = one.body_q.numpy()[0].astype(float), one.body_qd.numpy()[0].astype(float)
    return {"quaternion": [pose[6], *pose[3:6]], "omega_world": rates[3:].tolist()}


_MJCF = """<mujoco><option integrator="{}" timestep="{}" gravity="0 0 0"/><worldbody><body><freejoint/>
<inertial pos="0 0 0" mass="1" diaginertia="1 2 3"/></body></worldbody></mujoco>"""

_SPELT = {"euler": "Euler", "rk4": "RK4"}


def mujoco_warp(method: str) -> dict[str, Any]:
    """Put MuJoCo's model into Warp."""
    import mujoco
    import mujoco_warp as mjw

    model = mujoco.MjModel.from_xml_string(_MJCF.format(_SPELT.get(method, method), DT))
    data = mujoco.MjData(model)
    data.qvel[3:] = OMEGA
    on_warp, state = mjw.put_model(model), mjw.put_data(model, data)
    for _ in range(STEPS):
        mjw.step(on_warp, state)
    qpos, qvel = state.qpos.numpy()[0].astype(float), state.qvel.numpy()[0].astype(float)
    return {"quaternion": qpos[3:].tolist(), "omega_body": qvel[3:].tolist()}


def mjx(method: str) -> dict[str, Any]:
    """Put MuJoCo's model into JAX."""
    import jax
    import mujoco
    from mujoco import mjx as xla

    name, _, double = method.partition("@")
    jax.config.update("jax_enable_x64", bool(double))
    model = mujoco.MjModel.from_xml_string(_MJCF.format(_SPELT.get(name, name), DT))
    on_jax = xla.put_model(model)
    data = xla.make_data(on_jax)
    data = data.replace(qvel=data.qvel.at[3:].set(np.array(OMEGA)))
    step = jax.jit(xla.step)
    for _ in range(STEPS):
        data = step(on_jax, data)
    qpos, qvel = np.asarray(data.qpos, float), np.asarray(data.qvel, float)
    return {"quaternion": qpos[3:].tolist(), "omega_body": qvel[3:].tolist()}


def sapien(method: str) -> dict[str, Any]:
    """Step a PhysX system on the CPU."""
    warnings.simplefilter("ignore")
    import sapien as sp
    from sapien import physx

    settings = physx.PhysxSceneConfig()
    settings.gravity = np.zeros(3)
    physx.set_scene_config(settings)
    system = physx.PhysxCpuSystem()
    system.timestep = DT
    scene, entity, body = sp.Scene([system]), sp.Entity(), physx.PhysxRigidDynamicComponent()
    body.mass, body.inertia = 1.0, np.array(MOMENTS)
    if "@" not in method:
        body.angular_damping = 0.0
    entity.add_component(body)
    scene.add_entity(entity)
    body.angular_velocity = np.array(OMEGA)
    for _ in range(STEPS):
        system.step()
    omega = [float(value) for value in body.angular_velocity]
    return {"quaternion": [float(value) for value in entity.pose.q], "omega_world": omega}


def exudyn(method: str) -> dict[str, Any]:
    """Solve a system of one body from the start to the end."""
    warnings.simplefilter("ignore")
    import exudyn as exu
    from exudyn.itemInterface import NodeRigidBodyRotVecLG, ObjectRigidBody

    container = exu.SystemContainer()
    system = container.AddSystem()
    node = system.AddNode(
        NodeRigidBodyRotVecLG(referenceCoordinates=[0] * 6, initialVelocities=[0, 0, 0, *OMEGA])
    )
    system.AddObject(ObjectRigidBody(physicsMass=1, physicsInertia=[*MOMENTS, 0, 0, 0], nodeNumber=node))
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.solutionSettings.writeSolutionToFile = False
    steps = settings.timeIntegration
    steps.endTime, steps.numberOfSteps = STEPS * DT, STEPS
    steps.automaticStepSize = steps.adaptiveStep = False
    steps.newton.useModifiedNewton = False
    called = {
        "explicit-euler": "ExplicitEuler", "explicit-midpoint": "ExplicitMidpoint", "rk44": "RK44",
        "dopri5": "DOPRI5", "rk67": "RK67", "trapezoidal-index2": "TrapezoidalIndex2",
    }[method]  # fmt: skip
    system.SolveDynamic(settings, solverType=getattr(exu.DynamicSolverType, called))
    turn = system.GetNodeOutput(node, exu.OutputVariableType.RotationMatrix).reshape(3, 3)
    omega = system.GetNodeOutput(node, exu.OutputVariableType.AngularVelocityLocal)
    return {"rotation": turn.tolist(), "omega_body": list(omega)}


def basilisk(method: str) -> dict[str, Any]:
    """Run a simulation with one task, as Basilisk's own scenarios do."""
    from Basilisk.simulation import spacecraft, svIntegrators
    from Basilisk.utilities import SimulationBaseClass, macros

    simulation = SimulationBaseClass.SimBaseClass()
    simulation.CreateNewProcess("process").addTask(simulation.CreateNewTask("task", macros.sec2nano(DT)))
    craft = spacecraft.Spacecraft()
    craft.hub.mHub, craft.hub.IHubPntBc_B = 1.0, np.diag(MOMENTS).tolist()
    craft.hub.omega_BN_BInit = [[value] for value in OMEGA]
    called = {"euler": "svIntegratorEuler", "rk2": "svIntegratorRK2", "rk4": "svIntegratorRK4"}[method]
    integrator = getattr(svIntegrators, called)(craft)
    craft.setIntegrator(integrator)
    simulation.AddModelToTask("task", craft)
    simulation.InitializeSimulation()
    simulation.ConfigureStopTime(macros.sec2nano(DT * STEPS))
    simulation.ExecuteSimulation()
    state = craft.scStateOutMsg.read()
    sigma = np.array(state.sigma_BN)
    quaternion = np.concatenate([[1.0 - sigma @ sigma], 2.0 * sigma]) / (1.0 + sigma @ sigma)
    return {"quaternion": quaternion.tolist(), "omega_body": list(state.omega_BN_B)}


def jsbsim(method: str) -> dict[str, Any]:
    """Run a vehicle that is a mass alone, in its own units, above a planet without gravity or rotation."""
    import jsbsim as j

    at = '<location unit="FT"><x>0</x><y>0</y><z>0</z></location>'
    moments = "".join(
        f'<i{axis}{axis} unit="SLUG*FT2">{value}</i{axis}{axis}>'
        for axis, value in zip("xyz", MOMENTS, strict=True)
    )
    vehicle = f"""<?xml version="1.0"?><fdm_config name="v" version="2.0" release="ALPHA"><metrics>
<wingarea unit="FT2">1</wingarea><wingspan unit="FT">1</wingspan><chord unit="FT">1</chord>
{at.replace("<location", '<location name="AERORP"')}</metrics><mass_balance>{moments}
<emptywt unit="LBS">32.174049</emptywt>{at.replace("<location", '<location name="CG"')}</mass_balance>
<ground_reactions/><propulsion/><flight_control name="none"/><aerodynamics/></fdm_config>"""
    planet = """<?xml version="1.0"?><planet name="p"><equatorial_radius unit="FT">100</equatorial_radius>
<polar_radius unit="FT">100</polar_radius><GM unit="FT3/SEC2">1e-300</GM><J2>0</J2>
<rotation_rate unit="RAD/SEC">0</rotation_rate></planet>"""
    with TemporaryDirectory() as folder:
        Path(folder, "aircraft/v").mkdir(parents=True)
        Path(folder, "aircraft/v/v.xml").write_text(vehicle)
        Path(folder, "planet.xml").write_text(planet)
        fdm = j.FGFDMExec(folder)
        fdm.load_model("v")
        fdm.load_planet(str(Path(folder, "planet.xml")), False)
    fdm.set_dt(DT)
    numbers = {
        "default": (1, 1), "trapezoidal": (2, 2), "adams-bashforth2": (3, 3), "adams-bashforth3": (4, 4),
        "adams-bashforth4": (5, 5), "buss1": (3, 6), "buss2": (3, 7), "linearised": (3, 8),
    }[method]  # fmt: skip
    for place, number in zip(("rate", "position"), numbers, strict=True):
        fdm[f"simulation/integrator/{place}/rotational"] = number
    fdm["ic/h-sl-ft"] = 100.0
    for axis, value in zip("pqr", OMEGA, strict=True):
        fdm[f"ic/{axis}-rad_sec"] = value
    fdm.run_ic()
    start = np.array(fdm.get_propagate().get_Tec2b())
    for _ in range(STEPS):
        fdm.run()
    turn = start @ np.array(fdm.get_propagate().get_Tec2b()).T
    return {"rotation": turn.tolist(), "omega_body": [fdm[f"velocities/{axis}-rad_sec"] for axis in "pqr"]}


def simbody(method: str) -> dict[str, Any]:
    """Integrate a model of one body on a free joint, each step by one call of a new manager."""
    import opensim as o

    o.Logger.setLevelString("Off")
    model = o.Model()
    model.setGravity(o.Vec3(0.0))
    body = o.Body("b", 1.0, o.Vec3(0.0), o.Inertia(*MOMENTS, 0.0, 0.0, 0.0))
    model.addBody(body)
    joint = o.FreeJoint("j", model.getGround(), body)
    model.addJoint(joint)
    state = model.initSystem()
    for index, value in enumerate(OMEGA):
        joint.upd_coordinates(index).setSpeedValue(state, value)
    called = "".join(word.capitalize() for word in method.split("-")).replace("kutta", "Kutta")
    for step in range(STEPS):
        manager = o.Manager(model)
        manager.setIntegratorMethod(getattr(o.Manager, f"IntegratorMethod_{called}"))
        manager.setIntegratorFixedStepSize(2.0 * DT)
        state.setTime(step * DT)
        manager.initialize(state)
        state = o.State(manager.integrate((step + 1) * DT))
    model.realizeVelocity(state)
    turn = body.getTransformInGround(state).R()
    rotation = [[turn.get(i, k) for k in range(3)] for i in range(3)]
    return {"rotation": rotation, "omega_world": body.getAngularVelocityInGround(state).to_numpy().tolist()}


def ode(method: str) -> dict[str, Any]:
    """Step a world by ctypes."""
    from ctypes import CDLL, POINTER, byref, c_double, c_void_p
    from ctypes.util import find_library

    lib: Any = CDLL(find_library("ode"))
    lib.dWorldCreate.restype = lib.dBodyCreate.restype = c_void_p
    lib.dBodyGetQuaternion.restype = lib.dBodyGetAngularVel.restype = POINTER(c_double)
    lib.dInitODE2(0)
    world = c_void_p(lib.dWorldCreate())
    body = c_void_p(lib.dBodyCreate(world))
    mass = (c_double * 17)()
    numbers = (1.0, 0.0, 0.0, 0.0, *MOMENTS, 0.0, 0.0, 0.0)
    lib.dMassSetParameters(byref(mass), *map(c_double, numbers))
    lib.dBodySetMass(body, byref(mass))
    lib.dBodySetFiniteRotationMode(body, int(method == "step-finite"))
    lib.dBodySetAngularVel(body, *map(c_double, OMEGA))
    for _ in range(STEPS):
        lib.dWorldStep(world, c_double(DT))
    return {"quaternion": lib.dBodyGetQuaternion(body)[:4], "omega_world": lib.dBodyGetAngularVel(body)[:3]}


DRIVERS: dict[str, Callable[[str], dict[str, Any]]] = {
    **{
        driver.__name__: driver
        for driver in (
            rapier,
            drake,
            pinocchio,
            scipy,
            heyoka,
            newton,
            mjx,
            sapien,
            exudyn,
            basilisk,
            jsbsim,
            simbody,
            ode,
        )
    },
    "mujoco-warp": mujoco_warp,
}

if __name__ == "__main__":
    print(json.dumps(DRIVERS[sys.argv[1]](sys.argv[2])))
