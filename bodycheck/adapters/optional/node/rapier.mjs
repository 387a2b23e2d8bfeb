// Rapier through @dimforge/rapier3d-compat: a body without colliders, in float32.
import { diagonal, matrixOf, principal, product, times, transposed } from "./vectors.mjs";
import { imported, serve } from "./protocol.mjs";

const vector = ([x, y, z]) => ({ x, y, z });
const turn = ([w, x, y, z]) => ({ x, y, z, w });
const numbers = ({ x, y, z }) => [x, y, z];
const scalarFirst = ({ x, y, z, w }) => [w, x, y, z];

const RAPIER = await imported("@dimforge/rapier3d-compat");
await RAPIER.init();

function create(scene, method, dt_s) {
  const world = new RAPIER.World(vector(scene.gravity));
  world.timestep = dt_s;
  const { moments, axes } = principal(scene.body.inertia);
  const built = RAPIER.RigidBodyDesc.dynamic();
  built.setAdditionalMassProperties(scene.body.mass, vector([0, 0, 0]), vector(moments), turn(axes));
  if (!method.endsWith("@defaults")) built.setCanSleep(false);
  const body = world.createRigidBody(built);
  body.recomputeMassPropertiesFromColliders();
  return {
    model() {
      const A = matrixOf(scalarFirst(body.principalInertiaLocalFrame()));
      const inertia = product(A, product(diagonal(numbers(body.principalInertia())), transposed(A)));
      return { mass: body.mass(), inertia, dt_s: world.timestep, gravity: numbers(world.gravity) };
    },
    set(state) {
      body.resetForces(false);
      body.resetTorques(false);
      body.setTranslation(vector(state.position), true);
      body.setRotation(turn(state.quaternion), true);
      body.setLinvel(vector(state.velocity), true);
      body.setAngvel(vector(times(matrixOf(state.quaternion), state.omega_body)), true);
    },
    push({ force, torque }) {
      body.resetForces(false);
      body.resetTorques(false);
      body.addForce(vector(force), true);
      body.addTorque(vector(torque), true);
    },
    step: () => world.step(),
    read: () => ({
      position: numbers(body.translation()),
      velocity: numbers(body.linvel()),
      quaternion: scalarFirst(body.rotation()),
      omega_world: numbers(body.angvel()),
    }),
  };
}

await serve("rapier.json", create);
