// A worker for bodycheck in JavaScript: the map M1 for a free body under gravity, without other loads.
//     bodycheck run free-body --engine "cmd:node m1.mjs"
import { createInterface } from "node:readline";

const METHOD = {
  name: "m1",
  formula: "omega += h I^-1 (-omega x I omega); q = q exp(h omega / 2)",
  order: 1,
  evaluations: 1,
  torque: "zero-order hold",
  conserves: "|q| to round-off",
  source: "semi-implicit Euler",
};

const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
const times = (m, v) => m.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
const plus = (a, s, b) => a.map((x, i) => x + s * b[i]);

function inverse(m) {
  const columns = [cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])];
  const det = m[0][0] * columns[0][0] + m[0][1] * columns[0][1] + m[0][2] * columns[0][2];
  return [0, 1, 2].map((i) => columns.map((column) => column[i] / det));
}

function quaternionTimes(p, q) {
  return [
    p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
    p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
    p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
    p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
  ];
}

function exp(v) {
  const half = 0.5 * Math.hypot(...v);
  const s = half > 0 ? (0.5 * Math.sin(half)) / half : 0.5;
  return [Math.cos(half), s * v[0], s * v[1], s * v[2]];
}

function step(state, body, gravity, h) {
  const { inertia, inverted } = body;
  state.velocity = plus(state.velocity, h, gravity);
  state.position = plus(state.position, h, state.velocity);
  const gyroscopic = cross(state.omega_body, times(inertia, state.omega_body));
  state.omega_body = plus(state.omega_body, -h, times(inverted, gyroscopic));
  const q = quaternionTimes(state.quaternion, exp(state.omega_body.map((w) => h * w)));
  const size = Math.hypot(...q);
  state.quaternion = q.map((x) => x / size);
}

// Makes all steps; returns the step and the state at each sample.
function run({ scene, dt_s }) {
  const state = structuredClone(scene.initial);
  const body = { inertia: scene.body.inertia, inverted: inverse(scene.body.inertia) };
  const interval = scene.duration_s / (scene.samples - 1);
  const steps = Math.round(interval / dt_s);
  const h = scene.duration_s / (steps * (scene.samples - 1));
  const path = [{ ...state }];
  for (let k = 1; k < scene.samples; k++) {
    for (let i = 0; i < steps; i++) step(state, body, scene.gravity, h);
    path.push({ ...state });
  }
  return { h, path };
}

// again: whether the case is run, read back, reset and run again.
function record(request, again) {
  const { scene } = request;
  if (request.method !== METHOD.name) return { outcome: "unsupported", message: `no method ${request.method}` };
  if (scene.loads.length > 0 || scene.pivot || scene.link)
    return { outcome: "unsupported", message: "only free bodies under gravity" };
  const { h, path } = run(request);
  const state = again ? path.at(-1) : path[0];
  const read_back = { ...scene.body, dt_s: h, gravity: scene.gravity, state };
  return { outcome: "ok", trajectory: again ? run(request).path : path, read_back };
}

let prepared = null;

function answer(request) {
  switch (request.do) {
    case "record":
      return record(request.case, false);
    case "replay":
      return record(request.case, true);
    case "prepare":
      prepared = request.case;
      run(prepared);
      return { outcome: "ok" };
    case "lap": {
      const begin = process.cpuUsage();
      run(prepared);
      const { user, system } = process.cpuUsage(begin);
      return { outcome: "ok", cpu_s: 1e-6 * (user + system) };
    }
    case "stable-step":
      return { outcome: "unsupported", message: "no search for the largest stable step" };
    default:
      throw new Error(`unexpected request ${request.do}`);
  }
}

const say = (message) => process.stdout.write(JSON.stringify(message) + "\n");

say({
  bodycheck: 1,
  engine: "m1-js",
  version: process.versions.node,
  methods: [{ ...METHOD, control: "dt", changed_defaults: [], tolerances: [] }],
  limits: { message_bytes: 1 << 29 },
  build: "",
});
for await (const line of createInterface({ input: process.stdin })) {
  let id = null;
  try {
    const request = JSON.parse(line);
    id = request.id;
    say({ id, ...answer(request) });
  } catch (error) {
    say({ id, outcome: "failed", message: String(error) });
  }
}
