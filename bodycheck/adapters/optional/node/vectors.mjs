// Vectors (3), matrices (3 rows) and quaternions [w, x, y, z] as arrays.

export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const times = (m, v) => m.map((row) => dot(row, v));
export const plus = (a, s, b) => a.map((x, i) => x + s * b[i]);
export const transposed = (m) => [0, 1, 2].map((i) => m.map((row) => row[i]));
export const product = (a, b) => transposed(transposed(b).map((column) => times(a, column)));
export const diagonal = (d) => [[d[0], 0, 0], [0, d[1], 0], [0, 0, d[2]]];
export const conjugate = (q) => [q[0], -q[1], -q[2], -q[3]];

export function quaternionProduct(p, q) {
  return [
    p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
    p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
    p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
    p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
  ];
}

// R of q / |q|.
export function matrixOf(q) {
  const size = Math.hypot(...q);
  const [w, x, y, z] = q.map((c) => c / size);
  return [
    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

// The rotation vector of q / |q|, of at most pi.
export function rotationVector(q) {
  const s = q[0] < 0 ? -1 : 1;
  const size = Math.hypot(q[1], q[2], q[3]);
  const angle = 2 * Math.atan2(size, s * q[0]);
  const factor = size > 0 ? (s * angle) / size : 2 * s;
  return [factor * q[1], factor * q[2], factor * q[3]];
}

// I = A diag(moments) A^T by Jacobi rotations, which are collected in the quaternion of A.
export function principal(inertia) {
  let m = inertia, axes = [1, 0, 0, 0];
  for (let sweep = 0; sweep < 30; sweep++) {
    let changed = false;
    for (const [i, j, k] of [[0, 1, 2], [1, 2, 0], [2, 0, 1]]) {
      if (Math.abs(m[i][j]) <= 1e-17 * (Math.abs(m[i][i]) + Math.abs(m[j][j]))) continue;
      changed = true;
      const half = 0.25 * Math.atan2(2 * m[i][j], m[i][i] - m[j][j]);
      const turn = [Math.cos(half), 0, 0, 0];
      turn[1 + k] = Math.sin(half);
      axes = quaternionProduct(axes, turn);
      const a = matrixOf(axes);
      m = product(transposed(a), product(inertia, a));
    }
    if (!changed) break;
  }
  return { moments: [m[0][0], m[1][1], m[2][2]], axes };
}
