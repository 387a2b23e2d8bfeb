// The same free body in each JavaScript engine by its own calls, without bodycheck; see engine_drivers.py.
// node engine_drivers.mjs ENGINE METHOD, with BODYCHECK_NODE_PACKAGES naming the folder of node_modules.
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [, , engine, method] = process.argv;
const { resolve } = createRequire(`${process.env.BODYCHECK_NODE_PACKAGES}/driver.mjs`);
const load = async (name) => import(pathToFileURL(resolve(name))).then((found) => found.default ?? found);
const DT = 1e-2, STEPS = 100, defaults = method.endsWith("@defaults");

const drivers = {
  async "rapier-js"() {
    const R = await load("@dimforge/rapier3d-compat");
    await R.init();
    const world = new R.World({ x: 0, y: 0, z: 0 });
    world.timestep = DT;
    const zero = { x: 0, y: 0, z: 0 }, moments = { x: 1, y: 2, z: 3 }, none = { x: 0, y: 0, z: 0, w: 1 };
    const built = R.RigidBodyDesc.dynamic().setAngvel({ x: 0.1, y: 2, z: 0.1 });
    const body = world.createRigidBody(built.setAdditionalMassProperties(1, zero, moments, none));
    for (let i = 0; i < STEPS; i++) world.step();
    const q = body.rotation(), w = body.angvel();
    return { quaternion: [q.w, q.x, q.y, q.z], omega_world: [w.x, w.y, w.z] };
  },
  async "cannon-es"() {
    const C = await load("cannon-es");
    const world = new C.World();
    const body = new C.Body({ mass: 1, angularVelocity: new C.Vec3(0.1, 2, 0.1) });
    if (!defaults) body.angularDamping = 0;
    world.addBody(body);
    body.inertia.set(1, 2, 3);
    body.invInertia.set(1, 1 / 2, 1 / 3);
    body.updateInertiaWorld(true);
    for (let i = 0; i < STEPS; i++) {
      if (!defaults) {
        const w = body.quaternion.conjugate().vmult(body.angularVelocity);
        const torque = new C.Vec3((2 - 3) * w.y * w.z, (3 - 1) * w.z * w.x, (1 - 2) * w.x * w.y); // I omega x omega
        body.torque.copy(body.quaternion.vmult(torque));
      }
      world.step(DT);
    }
    const q = body.quaternion, w = body.angularVelocity;
    return { quaternion: [q.w, q.x, q.y, q.z], omega_world: [w.x, w.y, w.z] };
  },
  async "jolt-js"() {
    const J = await (await load("jolt-physics"))();
    const settings = new J.JoltSettings();
    const layers = new J.BroadPhaseLayerInterfaceTable(1, 1), pairs = new J.ObjectLayerPairFilterTable(1);
    layers.MapObjectToBroadPhaseLayer(0, new J.BroadPhaseLayer(0));
    settings.mBroadPhaseLayerInterface = layers;
    settings.mObjectLayerPairFilter = pairs;
    settings.mObjectVsBroadPhaseLayerFilter = new J.ObjectVsBroadPhaseLayerFilterTable(layers, 1, pairs, 1);
    const jolt = new J.JoltInterface(settings), bodies = jolt.GetPhysicsSystem().GetBodyInterface();
    jolt.GetPhysicsSystem().SetGravity(new J.Vec3(0, 0, 0));
    const shape = new J.SphereShape(1);
    const body = new J.BodyCreationSettings(shape, new J.RVec3(0, 0, 0), new J.Quat(0, 0, 0, 1), J.EMotionType_Dynamic, 0);
    body.mOverrideMassProperties = J.EOverrideMassProperties_MassAndInertiaProvided;
    body.mMassPropertiesOverride.mMass = 1;
    body.mMassPropertiesOverride.mInertia = J.Mat44.prototype.sScaleVec3(new J.Vec3(1, 2, 3));
    if (!defaults) {
      body.mApplyGyroscopicForce = true;
      body.mAngularDamping = 0;
    }
    const made = bodies.CreateBody(body);
    bodies.AddBody(made.GetID(), J.EActivation_Activate);
    bodies.SetAngularVelocity(made.GetID(), new J.Vec3(0.1, 2, 0.1));
    for (let i = 0; i < STEPS; i++) jolt.Step(DT, 1);
    const q = made.GetRotation(), w = made.GetAngularVelocity();
    return { quaternion: [q.GetW(), q.GetX(), q.GetY(), q.GetZ()], omega_world: [w.GetX(), w.GetY(), w.GetZ()] };
  },
};

console.log(JSON.stringify(await drivers[engine]()));
