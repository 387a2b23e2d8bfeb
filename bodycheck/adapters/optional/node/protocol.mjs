// The worker's side of bodycheck's protocol (docs/workers.md), for engines that take loads between steps.
import { createHash } from "node:crypto";
import { readFileSync, readdirSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join, resolve } from "node:path";
import { createInterface } from "node:readline";
import { fileURLToPath, pathToFileURL } from "node:url";
import { unsupportedLoad, wrenchOf } from "./loads.mjs";

const HERE = dirname(fileURLToPath(import.meta.url));
const PACKAGES = process.env.BODYCHECK_NODE_PACKAGES;

// Imports a package of the environment that bodycheck has made for this worker.
export async function imported(name) {
  const required = createRequire(join(PACKAGES, "worker.mjs"));
  const found = await import(pathToFileURL(required.resolve(name)));
  return found.default ?? found;
}

function identity() {
  const hash = createHash("sha256").update(process.version + process.arch);
  for (const file of readdirSync(HERE).sort()) hash.update(readFileSync(join(HERE, file)));
  return hash.update(readFileSync(join(PACKAGES, "package-lock.json"))).digest("hex");
}

// An array as the protocol has it: its shape and its little-endian doubles.
function array(rows) {
  const shape = Array.isArray(rows[0]) ? [rows.length, rows[0].length] : [rows.length];
  return { shape, base64: Buffer.from(Float64Array.from(rows.flat(2)).buffer).toString("base64") };
}

function matrix(rows) {
  return { shape: [3, 3], base64: Buffer.from(Float64Array.from(rows.flat()).buffer).toString("base64") };
}

const NAMES = {
  position: "position_m",
  velocity: "velocity_m_s",
  quaternion: "quaternion",
  omega_world: "omega_world_rad_s",
};

class Simulation {
  constructor(engine, { scene, method, dt_s }) {
    this.scene = scene;
    this.stride = Math.round(scene.duration_s / (scene.samples - 1) / dt_s);
    this.dt = scene.duration_s / (this.stride * (scene.samples - 1));
    this.body = engine(scene, method, this.dt);
  }

  // Makes all steps from the initial state; calls `sampled(state)` at each sample.
  run(sampled) {
    const { scene, body, stride, dt } = this;
    body.set(scene.initial);
    sampled(body.read());
    for (let k = 0, step = 0; k < scene.samples - 1; k++) {
      for (let i = 0; i < stride; i++, step++) {
        if (scene.loads.length > 0) body.push(wrenchOf(scene, body.read(), step, dt));
        body.step();
      }
      sampled(body.read());
    }
  }

  readBack() {
    const { mass, inertia, dt_s, gravity } = this.body.model();
    const state = Object.fromEntries(Object.entries(this.body.read()).map(([name, value]) => [name, array(value)]));
    return { mass, inertia: matrix(inertia), dt_s, gravity: array(gravity), state };
  }

  answer(read_back, states) {
    const n = this.scene.samples;
    const trajectory = { t_s: array(states.map((_, k) => (k * this.scene.duration_s) / (n - 1))) };
    for (const [name, column] of Object.entries(NAMES)) trajectory[column] = array(states.map((state) => state[name]));
    return { outcome: "ok", message: "", trajectory, read_back, stepping: "native", steps: null };
  }
}

function refusal(methods, { scene, method }) {
  if (!methods.some(({ name }) => name === method)) return `no method '${method}'`;
  if (scene.pivot) return "the adapter has no joint for a pivot";
  if (scene.link) return "the engine's own frame of the body is at the centre of mass";
  return unsupportedLoad(scene);
}

// Announces the engine of a file of facts and answers requests. create: (scene, method, dt_s) => a body with
// model(), set(state), push({force, torque}) for the next step, step() and read(), all in world axes.
export async function serve(factsFile, create) {
  const facts = JSON.parse(readFileSync(resolve(HERE, factsFile), "utf-8"));
  const { version } = JSON.parse(readFileSync(join(PACKAGES, "node_modules", facts.distribution, "package.json"), "utf-8"));
  const say = (message) => process.stdout.write(JSON.stringify(message) + "\n");
  let prepared = null;

  function answer(request) {
    const reason = request.case ? refusal(facts.methods, request.case) : null;
    if (reason) return { outcome: "unsupported", message: reason };
    switch (request.do) {
      case "record": {
        const simulation = new Simulation(create, request.case), states = [];
        simulation.body.set(simulation.scene.initial);
        const readBack = simulation.readBack();
        simulation.run((state) => states.push(state));
        return simulation.answer(readBack, states);
      }
      case "replay": {
        const simulation = new Simulation(create, request.case), states = [];
        simulation.run(() => {});
        const readBack = simulation.readBack();
        simulation.run((state) => states.push(state));
        return simulation.answer(readBack, states);
      }
      case "prepare":
        prepared = new Simulation(create, request.case);
        prepared.run(() => {});
        return { outcome: "ok" };
      case "lap": {
        const begin = process.cpuUsage();
        prepared.run(() => {});
        const { user, system } = process.cpuUsage(begin);
        return { outcome: "ok", cpu_s: 1e-6 * (user + system) };
      }
      case "stable-step":
        return { outcome: "unsupported", message: "no search for the largest stable step" };
      default:
        throw new Error(`unexpected request ${request.do}`);
    }
  }

  const limits = { message_bytes: 1 << 29 };
  say({ bodycheck: 1, engine: facts.name, version, methods: facts.methods, limits, build: identity() });
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
}
