// Engines in JavaScript by themselves: node javascript.mjs EXPERIMENT; the folder of their packages is in the environment.
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const from = createRequire(`${process.env.BODYCHECK_NODE_PACKAGES}/node_modules/`);
const load = async (name) => await import(pathToFileURL(from.resolve(name)));

// |L| of a body in world axes: R I R^T omega, its moments along the axes of quaternion (x, y, z, w)
function momentum(moments, { x, y, z, w }, omega) {
  const R = [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
  const body = [0, 1, 2].map((i) => moments[i] * [0, 1, 2].reduce((sum, k) => sum + R[k][i] * omega[k], 0));
  return R.map((row) => row.reduce((sum, value, k) => sum + value * body[k], 0));
}
const change = (before, after) => Math.hypot(...before.map((value, k) => after[k] - value)) / Math.hypot(...before);

const MOMENTS = [2, 2, 1], SPIN = [0.6, 0, 3];

async function cannon(options) {
  const CANNON = await load("cannon-es");
  const world = new CANNON.World();
  const body = new CANNON.Body({ mass: 1, ...options });
  world.addBody(body);
  body.inertia.set(...MOMENTS);
  body.invInertia.set(...MOMENTS.map((moment) => 1 / moment));
  return { world, body };
}

async function jolt(change) {
  const Jolt = await (await load("jolt-physics")).default();
  const settings = new Jolt.JoltSettings();
  const layers = new Jolt.BroadPhaseLayerInterfaceTable(1, 1);
  layers.MapObjectToBroadPhaseLayer(0, new Jolt.BroadPhaseLayer(0));
  const pairs = new Jolt.ObjectLayerPairFilterTable(1);
  settings.mBroadPhaseLayerInterface = layers;
  settings.mObjectLayerPairFilter = pairs;
  settings.mObjectVsBroadPhaseLayerFilter = new Jolt.ObjectVsBroadPhaseLayerFilterTable(layers, 1, pairs, 1);
  const world = new Jolt.JoltInterface(settings), bodies = world.GetPhysicsSystem().GetBodyInterface();
  world.GetPhysicsSystem().SetGravity(new Jolt.Vec3(0, 0, 0));
  const made = new Jolt.BodyCreationSettings(
    new Jolt.SphereShape(1), new Jolt.RVec3(0, 0, 0), new Jolt.Quat(0, 0, 0, 1), Jolt.EMotionType_Dynamic, 0,
  );
  made.mOverrideMassProperties = Jolt.EOverrideMassProperties_MassAndInertiaProvided;
  made.mMassPropertiesOverride.mMass = 1;
  MOMENTS.forEach((moment, i) => {
    const column = [0, 0, 0, 0];
    column[i] = moment;
    made.mMassPropertiesOverride.mInertia.SetColumn4(i, new Jolt.Vec4(...column));
  });
  made.mMassPropertiesOverride.mInertia.SetColumn4(3, new Jolt.Vec4(0, 0, 0, 1));
  Object.assign(made, change);
  const body = bodies.CreateBody(made);
  bodies.AddBody(body.GetID(), Jolt.EActivation_Activate);
  return { Jolt, world, bodies, body };
}

async function joltSpin(change, omega, steps, dt) {
  const { Jolt, world, bodies, body } = await jolt(change);
  bodies.SetAngularVelocity(body.GetID(), new Jolt.Vec3(...omega));
  const before = omega.map((value, k) => MOMENTS[k] * value);
  for (let k = 0; k < steps; k++) world.Step(dt, 1);
  const w = body.GetAngularVelocity(), q = body.GetRotation();
  const after = [w.GetX(), w.GetY(), w.GetZ()];
  const L = momentum(MOMENTS, { x: q.GetX(), y: q.GetY(), z: q.GetZ(), w: q.GetW() }, after);
  return { omega: after, change: changeOf(before, L) };
}
const changeOf = change;

async function rapierBody(dt, omega, velocity) {
  const RAPIER = (await load("@dimforge/rapier3d-compat")).default;
  await RAPIER.init();
  const world = new RAPIER.World({ x: 0, y: 0, z: 0 });
  world.timestep = dt;
  const one = { x: 1, y: 1, z: 1 }, none = { x: 0, y: 0, z: 0 };
  const body = world.createRigidBody(
    RAPIER.RigidBodyDesc.dynamic().setAdditionalMassProperties(1, none, one, { x: 0, y: 0, z: 0, w: 1 }),
  );
  body.setAngvel({ x: 0, y: 0, z: omega }, true);
  body.setLinvel({ x: velocity, y: 0, z: 0 }, true);
  for (let k = 0; k < 2; k++) world.step();
  return [body.angvel().z, body.linvel().x];
}

const EXPERIMENTS = {
  // change of L of a free symmetric top after 1 s at 1e-2 and 1e-3 s, without damping
  async cannon_gyroscopic() {
    const found = [];
    for (const dt of [1e-2, 1e-3]) {
      const { world, body } = await cannon({ linearDamping: 0, angularDamping: 0 });
      body.angularVelocity.set(...SPIN);
      for (let k = 0; k < Math.round(1 / dt); k++) world.step(dt);
      const { x, y, z } = body.angularVelocity;
      found.push(change(SPIN.map((value, k) => MOMENTS[k] * value), momentum(MOMENTS, body.quaternion, [x, y, z])));
    }
    return found;
  },
  // omega after 1 s of a spin of 1 rad/s about a principal axis, by default
  async cannon_damping() {
    const { world, body } = await cannon({});
    body.angularVelocity.set(0, 0, 1);
    for (let k = 0; k < 1000; k++) world.step(1e-3);
    return [body.angularVelocity.z];
  },
  // change of L of a free symmetric top after 1 s at 1e-3 s: by default but without damping, and with the flag
  async jolt_gyroscopic() {
    const off = await joltSpin({ mAngularDamping: 0 }, SPIN, 1000, 1e-3);
    const on = await joltSpin({ mAngularDamping: 0, mApplyGyroscopicForce: true }, SPIN, 1000, 1e-3);
    return [off.change, on.change];
  },
  // omega after 1 s of a spin of 1 rad/s about a principal axis, by default
  async jolt_damping() {
    return [(await joltSpin({}, [0, 0, 1], 1000, 1e-3)).omega[2]];
  },
  // omega after one step of 1e-4 s of a spin of 150 rad/s about a principal axis
  async jolt_clamp() {
    return [(await joltSpin({}, [0, 0, 150], 1, 1e-4)).omega[2]];
  },
  // omega and speed after two steps of 1e-2 s of a body that starts with 400 rad/s and 1000 m/s
  async rapier_caps() {
    return await rapierBody(1e-2, 400, 1000);
  },
  // omega and fall in m of one of two bars on a hinge after 0.5 s of free fall from rest, without contacts:
  // in reduced coordinates, and by impulses
  async rapier_free_fall() {
    const { default: RAPIER } = await load("@dimforge/rapier3d-compat");
    await RAPIER.init();
    return ["createMultibodyJoint", "createImpulseJoint"].flatMap((create) => {
      const world = new RAPIER.World({ x: 0, y: -9.81, z: 0 });
      world.timestep = 1 / 120;
      const bars = [0.7, 1.7].map((x) => {
        const bar = world.createRigidBody(RAPIER.RigidBodyDesc.dynamic().setTranslation(x, 0, 0));
        world.createCollider(RAPIER.ColliderDesc.cuboid(0.5, 0.1, 0.1).setCollisionGroups(0), bar);
        return bar;
      });
      const ends = [{ x: 0.5, y: 0, z: 0 }, { x: -0.5, y: 0, z: 0 }];
      world[create](RAPIER.JointData.revolute(...ends, { x: 0, y: 0, z: 1 }), ...bars, true);
      for (let step = 0; step < 60; step += 1) world.step();
      return [Number(bars[0].angvel().z.toFixed(5)), -bars[0].translation().y];
    });
  },
};

console.log("figures", JSON.stringify(await EXPERIMENTS[process.argv[2]]()));
process.exit(0);
