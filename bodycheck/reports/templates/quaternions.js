// Quaternions (w, x, y, z) that rotate body axes to world axes, and interpolation between stored states.
const product = ([a, b, c, d], [w, x, y, z]) => [
  a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y,
  a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w,
];
const scaled = (v, factor) => v.map(x => x * factor);
const added = (u, v) => u.map((x, i) => x + v[i]);
const dot = (u, v) => u.reduce((sum, x, i) => sum + x * v[i], 0);
const unit = v => scaled(v, 1 / (Math.hypot(...v) || 1));
const cross = ([a, b, c], [x, y, z]) => [b * z - c * y, c * x - a * z, a * y - b * x];

function turned([w, ...v], x) {
  const c = cross(v, x).map(value => 2 * value);
  return added(added(x, scaled(c, w)), cross(v, c));
}

// Many vectors (n, 3), rotated from body to world axes.
function allTurned(q, vectors) {
  const [a, b, c] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map(axis => turned(q, axis));
  return vectors.map(([x, y, z]) => a.map((_, i) => a[i] * x + b[i] * y + c[i] * z));
}

// exp(v / 2) of a rotation vector v
function turn(vector) {
  const angle = Math.hypot(...vector);
  const half = angle ? Math.sin(angle / 2) / angle : 0.5;
  return [Math.cos(angle / 2), ...scaled(vector, half)];
}

// Extrapolate both neighbouring samples with their own omega and blend them: a body may turn far in between.
function stateAt({ q, omega }, times, t) {
  const k = Math.min(Math.max(times.findLastIndex(sample => sample <= t), 0), times.length - 2);
  const span = times[k + 1] - times[k];
  const part = Math.min(Math.max((t - times[k]) / span, 0), 1);
  const ahead = product(q[k], turn(scaled(omega[k], part * span)));
  let back = product(q[k + 1], turn(scaled(omega[k + 1], (part - 1) * span)));
  if (dot(ahead, back) < 0) back = scaled(back, -1);
  return {
    q: unit(added(scaled(ahead, 1 - part), scaled(back, part))),
    omega: added(scaled(omega[k], 1 - part), scaled(omega[k + 1], part)),
  };
}
