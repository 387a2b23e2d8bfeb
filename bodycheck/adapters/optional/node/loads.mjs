// The loads of a scene about the centre of mass, in world axes, at a state; the weight is the engine's.
import { conjugate, cross, matrixOf, plus, product, quaternionProduct, rotationVector, times, transposed } from "./vectors.mjs";

const ZERO = [0, 0, 0];
const ON_GRID = 1e-9; // of a step: a switch this near to a step's end counts as being there
const inWorld = (axes, R, v) => (axes === "body" ? times(R, v) : v);

// kind: (load, state, R, t, scene) => [force, torque]
const KINDS = {
  torque: (load, state, R) => [ZERO, inWorld(load.axes, R, load.value)],
  force: (load, state, R) => {
    const force = inWorld(load.axes, R, load.value);
    return [force, cross(times(R, load.at), force)];
  },
  "sine-torque": (load, state, R, t) => {
    const swing = Math.sin(load.rate * t + load.phase);
    return [ZERO, inWorld(load.axes, R, load.amplitude).map((x) => swing * x)];
  },
  drag: (load, state, R) => [
    state.velocity.map((v) => -load.linear * v),
    times(R, times(load.angular, times(transposed(R), state.omega_world))).map((x) => -x),
  ],
  spring: (load, state, R) => {
    const arm = times(R, load.at);
    const stretch = plus(plus(state.position, 1, arm), -1, load.anchor);
    const length = Math.hypot(...stretch);
    const share = length > 0 ? load.rest_length / length : 1;
    const force = stretch.map((x) => -load.stiffness * (1 - share) * x);
    return [force, cross(arm, force)];
  },
  "torsion-spring": (load, state, R, t, scene) => {
    const turn = quaternionProduct(state.quaternion, conjugate(scene.initial.quaternion));
    return [ZERO, rotationVector(turn).map((x) => -load.stiffness * x)];
  },
  "gravity-gradient": (load, state, R, t, scene) => {
    const u = [-Math.sin(load.rate * t), 0, -Math.cos(load.rate * t)];
    const inertia = product(R, product(scene.body.inertia, transposed(R)));
    return [ZERO, cross(u, times(inertia, u)).map((x) => 3 * load.rate ** 2 * x)];
  },
  "magnetic-dipole": (load, state, R) => [ZERO, cross(times(R, load.moment), load.field)],
};

export function unsupportedLoad(scene) {
  const unknown = scene.loads.find((load) => !(load.kind in KINDS));
  return unknown ? `a load of kind ${unknown.kind} cannot be passed to a JavaScript worker` : null;
}

// The share of the step [begin, end] in which a load acts.
function share(load, begin, end) {
  const until = load.until_s ?? Infinity;
  const acts = (Math.min(end, until) - Math.max(begin, load.from_s ?? 0)) / (end - begin);
  return acts < ON_GRID ? 0 : acts > 1 - ON_GRID ? 1 : acts;
}

// Force and torque for step number `step`, held constant over it (zero-order hold).
export function wrenchOf(scene, state, step, dt) {
  let force = ZERO, torque = ZERO;
  const R = matrixOf(state.quaternion);
  for (const load of scene.loads) {
    const s = share(load, step * dt, (step + 1) * dt);
    if (s === 0) continue;
    const [f, tau] = KINDS[load.kind](load, state, R, step * dt, scene);
    force = plus(force, s, f);
    torque = plus(torque, s, tau);
  }
  return { force, torque };
}
