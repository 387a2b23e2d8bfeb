// Jolt through jolt-physics: one body, in float32. Its shape is a sphere that never meets another: a body without
// a size does not move by Jolt's criterion, and would fall asleep.
import { diagonal, matrixOf, product, times, transposed } from "./vectors.mjs";
import { imported, serve } from "./protocol.mjs";

const initialise = await imported("jolt-physics");
const Jolt = await initialise();
const vector = (v) => new Jolt.Vec3(...v);
const numbers = (v) => [v.GetX(), v.GetY(), v.GetZ()];
const scalarFirst = (q) => [q.GetW(), q.GetX(), q.GetY(), q.GetZ()];
const LARGEST = 1e30;

function worldOf() {
  const settings = new Jolt.JoltSettings();
  const layers = new Jolt.BroadPhaseLayerInterfaceTable(1, 1);
  layers.MapObjectToBroadPhaseLayer(0, new Jolt.BroadPhaseLayer(0));
  const pairs = new Jolt.ObjectLayerPairFilterTable(1);
  settings.mBroadPhaseLayerInterface = layers;
  settings.mObjectLayerPairFilter = pairs;
  settings.mObjectVsBroadPhaseLayerFilter = new Jolt.ObjectVsBroadPhaseLayerFilterTable(layers, 1, pairs, 1);
  settings.mMaxBodies = 1;
  settings.mMaxWorkerThreads = 0;
  return new Jolt.JoltInterface(settings);
}

const world = worldOf(); // one for all cases: it allocates megabytes, and a WebAssembly heap never shrinks
let present = null;

function create(scene, method, dt_s) {
  const system = world.GetPhysicsSystem(), bodies = system.GetBodyInterface();
  if (present) {
    bodies.RemoveBody(present);
    bodies.DestroyBody(present);
  }
  system.SetGravity(vector(scene.gravity));
  const shape = new Jolt.SphereShape(1);
  const settings = new Jolt.BodyCreationSettings(
    shape, new Jolt.RVec3(0, 0, 0), new Jolt.Quat(0, 0, 0, 1), Jolt.EMotionType_Dynamic, 0,
  );
  settings.mOverrideMassProperties = Jolt.EOverrideMassProperties_MassAndInertiaProvided;
  settings.mMassPropertiesOverride.mMass = scene.body.mass;
  const inertia = settings.mMassPropertiesOverride.mInertia; // not by sScale, which takes a number
  scene.body.inertia.forEach((row, i) => inertia.SetColumn4(i, new Jolt.Vec4(...row, 0)));
  inertia.SetColumn4(3, new Jolt.Vec4(0, 0, 0, 1));
  if (!method.endsWith("@defaults")) {
    Object.assign(settings, { mLinearDamping: 0, mAngularDamping: 0, mAllowSleeping: false });
    Object.assign(settings, { mMaxLinearVelocity: LARGEST, mMaxAngularVelocity: LARGEST });
    settings.mApplyGyroscopicForce = true;
  }
  const body = bodies.CreateBody(settings), id = (present = body.GetID());
  bodies.AddBody(id, Jolt.EActivation_Activate);
  const motion = body.GetMotionProperties();
  return {
    model() {
      const A = matrixOf(scalarFirst(motion.GetInertiaRotation()));
      const moments = numbers(motion.GetInverseInertiaDiagonal()).map((inverse) => 1 / inverse);
      const held = product(A, product(diagonal(moments), transposed(A)));
      return { mass: 1 / motion.GetInverseMass(), inertia: held, dt_s, gravity: numbers(system.GetGravity()) };
    },
    set(state) {
      const [w, x, y, z] = state.quaternion;
      motion.ResetForce();
      motion.ResetTorque();
      const place = new Jolt.RVec3(...state.position), turn = new Jolt.Quat(x, y, z, w);
      bodies.SetPositionAndRotation(id, place, turn, Jolt.EActivation_Activate);
      bodies.SetLinearVelocity(id, vector(state.velocity));
      bodies.SetAngularVelocity(id, vector(times(matrixOf(state.quaternion), state.omega_body)));
    },
    push({ force, torque }) {
      const f = vector(force), t = vector(torque);
      bodies.AddForceAndTorque(id, f, t, Jolt.EActivation_Activate); // cleared by each step
      Jolt.destroy(f);
      Jolt.destroy(t);
    },
    step: () => world.Step(dt_s, 1),
    read: () => ({
      position: numbers(body.GetCenterOfMassPosition()),
      velocity: numbers(body.GetLinearVelocity()),
      quaternion: scalarFirst(body.GetRotation()),
      omega_world: numbers(body.GetAngularVelocity()),
    }),
  };
}

await serve("jolt.json", create);
