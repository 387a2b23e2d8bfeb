// cannon-es: a body without shapes, in float64. It has principal moments only, so its axes are the principal ones.
// It has no gyroscopic term: the fair method adds it to the torque of each step.
import { conjugate, cross, diagonal, matrixOf, plus, principal, product, quaternionProduct, times, transposed } from "./vectors.mjs";
import { imported, serve } from "./protocol.mjs";

const CANNON = await imported("cannon-es");
const numbers = ({ x, y, z }) => [x, y, z];

function create(scene, method, dt_s) {
  const { moments, axes } = principal(scene.body.inertia);
  const world = new CANNON.World({ gravity: new CANNON.Vec3(...scene.gravity) });
  const fair = !method.endsWith("@defaults");
  const body = new CANNON.Body({ mass: scene.body.mass, ...(fair ? { linearDamping: 0, angularDamping: 0 } : {}) });
  world.addBody(body);
  body.inertia.set(...moments); // after addBody, which computes that of the shapes
  body.invInertia.set(...moments.map((moment) => 1 / moment));
  const own = (quaternion) => quaternionProduct(quaternion, axes);
  // omega x I omega, in world axes
  function gyroscopic() {
    const { x, y, z, w } = body.quaternion, omega = numbers(body.angularVelocity);
    const R = matrixOf([w, x, y, z]);
    const momentum = times(transposed(R), omega).map((component, i) => moments[i] * component);
    return cross(omega, times(R, momentum));
  }
  return {
    model() {
      const A = matrixOf(axes);
      const inertia = product(A, product(diagonal(numbers(body.inertia)), transposed(A)));
      return { mass: body.mass, inertia, dt_s, gravity: numbers(world.gravity) };
    },
    set(state) {
      const [w, x, y, z] = own(state.quaternion);
      body.force.set(0, 0, 0);
      body.torque.set(0, 0, 0);
      body.position.set(...state.position);
      body.quaternion.set(x, y, z, w);
      body.velocity.set(...state.velocity);
      body.angularVelocity.set(...times(matrixOf(state.quaternion), state.omega_body));
      body.updateInertiaWorld(true);
    },
    push({ force, torque }) {
      body.force.set(...force);
      body.torque.set(...torque);
    },
    step() {
      if (fair) body.torque.set(...plus(numbers(body.torque), -1, gyroscopic()));
      world.step(dt_s);
    },
    read() {
      const { x, y, z, w } = body.quaternion;
      return {
        position: numbers(body.position),
        velocity: numbers(body.velocity),
        quaternion: quaternionProduct([w, x, y, z], conjugate(axes)),
        omega_world: numbers(body.angularVelocity),
      };
    },
  };
}

await serve("cannon.json", create);
