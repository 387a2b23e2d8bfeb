// The map M1 in plain JavaScript on the protocol of the JavaScript engines: a stand-in that needs no package.
import { pathToFileURL } from "node:url";

const folder = pathToFileURL(`${process.argv[2]}/`);
const { serve } = await import(new URL("protocol.mjs", folder));
const { cross, matrixOf, plus, principal, quaternionProduct, times, transposed } = await import(new URL("vectors.mjs", folder));

function exp(v) {
  const half = 0.5 * Math.hypot(...v);
  const s = half > 0 ? (0.5 * Math.sin(half)) / half : 0.5;
  return [Math.cos(half), s * v[0], s * v[1], s * v[2]];
}

function create(scene, method, dt_s) {
  const { mass, inertia } = scene.body;
  const { moments, axes } = principal(inertia), A = matrixOf(axes);
  const solved = (L) => times(A, times(transposed(A), L).map((x, i) => x / moments[i]));
  const none = { force: [0, 0, 0], torque: [0, 0, 0] };
  let state, pushed = none;
  return {
    model: () => ({ mass, inertia, dt_s, gravity: scene.gravity }),
    set(start) {
      state = structuredClone(start);
    },
    push(wrench) {
      pushed = wrench;
    },
    step() {
      const R = matrixOf(state.quaternion), omega = state.omega_body;
      const torque = plus(times(transposed(R), pushed.torque), -1, cross(omega, times(inertia, omega)));
      state.omega_body = plus(omega, dt_s, solved(torque));
      state.velocity = plus(plus(state.velocity, dt_s, scene.gravity), dt_s / mass, pushed.force);
      state.position = plus(state.position, dt_s, state.velocity);
      state.quaternion = quaternionProduct(state.quaternion, exp(state.omega_body.map((w) => dt_s * w)));
      pushed = none;
    },
    read() {
      const { position, velocity, quaternion, omega_body } = state;
      return { position, velocity, quaternion, omega_world: times(matrixOf(quaternion), omega_body) };
    },
  };
}

await serve(process.argv[3], create);
