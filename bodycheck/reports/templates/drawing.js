// Draws a rotating body, its momentum and its omega on a canvas: two square views, one above the other.
const TRUTH_DASH = [4, 3]; // of the edges of the true body, as in figures
const SHARP = 0.8; // faces whose normals have a smaller cosine meet in an edge that is drawn

const askew = v => (Math.abs(v[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]);

// The axes of a camera: right, up, and towards the eye, which is 25 degrees above the plane normal to `up`.
function camera(up, side = askew(up)) {
  const right = unit(cross(up, side));
  const eye = unit(added(scaled(up, Math.sin(0.44)), scaled(cross(right, up), Math.cos(0.44))));
  return [right, cross(eye, right), eye];
}

// The camera after a rotation of what it shows: to the right by yaw, upwards by pitch.
function orbited([right, up, eye], yaw, pitch) {
  const mixed = (u, v, angle) => [
    added(scaled(u, Math.cos(angle)), scaled(v, Math.sin(angle))), added(scaled(v, Math.cos(angle)), scaled(u, -Math.sin(angle))),
  ];
  const [across, ahead] = mixed(right, eye, yaw);
  return [across, ...mixed(up, ahead, pitch)].map(unit);
}

// The normal of a polygon, concave or not, as long as twice its area; normalised.
function normalOf(face, vertices) {
  let sum = [0, 0, 0];
  for (let k = 1; k + 1 < face.length; k++) {
    const [a, b, c] = [face[0], face[k], face[k + 1]].map(i => vertices[i]);
    sum = added(sum, cross(added(b, scaled(a, -1)), added(c, scaled(a, -1))));
  }
  return unit(sum);
}

// A stored surface with its normals and edges; edges where it bends, or where the marking ends, are sharp.
function surfaceOf({ vertices, faces, marked }) {
  const normals = faces.map(face => normalOf(face, vertices));
  const all = faces.map((corners, k) => ({ corners, marked: marked.includes(k), sharp: [] }));
  const edges = new Map();
  faces.forEach((face, k) => face.forEach((i, n) => {
    const ends = [i, face[(n + 1) % face.length]];
    const key = Math.min(...ends) * vertices.length + Math.max(...ends);
    if (!edges.has(key)) edges.set(key, { ends, between: [] });
    edges.get(key).between.push(k);
  }));
  for (const edge of edges.values()) {
    const [one, other] = edge.between;
    edge.sharp = other === undefined || dot(normals[one], normals[other]) < SHARP || all[one].marked !== all[other].marked;
    if (edge.sharp) for (const k of edge.between) all[k].sharp.push(edge.ends);
  }
  return { vertices, normals, faces: all, edges: [...edges.values()] };
}

// A surface after a rotation from body to world axes.
const posed = (surface, q) => ({ ...surface, corners: allTurned(q, surface.vertices), normals: allTurned(q, surface.normals) });

// A colour between two given as #rrggbb.
function blend(from, to, part) {
  const [a, b] = [from, to].map(text => [1, 3, 5].map(k => parseInt(text.slice(k, k + 2), 16)));
  return `rgb(${a.map((x, i) => Math.round(x + part * (b[i] - x))).join(" ")})`;
}

// A square view on the canvas: maps coordinates in [-reach, reach] to its pixels.
class View {
  constructor(context, axes, size, top, reach) {
    Object.assign(this, { context, axes, size, top, scale: size / 2 / reach });
  }

  place(v) {
    const [right, up] = this.axes;
    return [this.size / 2 + dot(right, v) * this.scale, this.top + this.size / 2 - dot(up, v) * this.scale];
  }

  line(points, ink, width, dash = []) {
    const { context } = this;
    context.beginPath();
    points.forEach((v, k) => context[k ? "lineTo" : "moveTo"](...this.place(v)));
    context.strokeStyle = ink;
    context.lineWidth = width;
    context.setLineDash(dash);
    context.stroke();
  }

  dot(v, ink) {
    const { context } = this;
    context.beginPath();
    context.arc(...this.place(v), 4, 0, 2 * Math.PI);
    context.fillStyle = ink;
    context.fill();
  }

  arrow(tip, ink, width) {
    this.line([[0, 0, 0], tip], ink, width);
    const [[x0, y0], [x1, y1]] = [this.place([0, 0, 0]), this.place(tip)];
    const angle = Math.atan2(y1 - y0, x1 - x0);
    const { context } = this;
    context.beginPath();
    context.moveTo(x1, y1);
    for (const side of [2.7, -2.7]) context.lineTo(x1 + 10 * Math.cos(angle + side), y1 + 10 * Math.sin(angle + side));
    context.fillStyle = ink;
    context.fill();
  }

  // The faces towards the eye, the farthest first, lighter at a smaller angle to it; marked ones are stronger.
  body({ faces, corners, normals }, paint) {
    const { context } = this;
    const [, , eye] = this.axes;
    const heights = corners.map(corner => dot(corner, eye));
    const seen = faces.map((face, k) => ({
      face, facing: dot(normals[k], eye), depth: face.corners.reduce((sum, i) => sum + heights[i], 0) / face.corners.length,
    })).filter(({ facing }) => facing > 0);
    for (const { face, facing } of seen.sort((a, b) => a.depth - b.depth)) {
      context.beginPath();
      for (const i of face.corners) context.lineTo(...this.place(corners[i]));
      context.closePath();
      context.fillStyle = blend(paint.paper, paint.ink, (face.marked ? 0.9 : 0.35) - 0.25 * facing);
      context.strokeStyle = context.fillStyle; // closes the seam to the next face
      context.lineWidth = 1;
      context.setLineDash([]);
      context.fill();
      context.stroke();
      for (const edge of face.sharp) this.line(edge.map(i => corners[i]), paint.edge, 1, paint.dash);
    }
  }

  // The edges and the outline of a body as the eye would see them, dashed.
  ghost({ edges, corners, normals }, ink) {
    const [, , eye] = this.axes;
    const towards = normals.map(normal => dot(normal, eye) > 0);
    for (const { ends, between, sharp } of edges) {
      const shown = between.filter(k => towards[k]).length;
      if (shown && (sharp || shown < between.length)) this.line(ends.map(i => corners[i]), ink, 1.25, TRUTH_DASH);
    }
  }

  // The outline of the ellipsoid with these semiaxes: the points whose normal is perpendicular to the line of sight.
  ellipsoid(semiaxes, paint) {
    const { context } = this;
    const [, , eye] = this.axes;
    const across = unit(eye.map((x, i) => x / semiaxes[i]));
    const u = unit(cross(across, askew(across)));
    const v = cross(across, u);
    context.beginPath();
    for (let angle = 0; angle < 2 * Math.PI; angle += 0.1) {
      const w = added(scaled(u, Math.cos(angle)), scaled(v, Math.sin(angle)));
      context.lineTo(...this.place(w.map((x, i) => x * semiaxes[i])));
    }
    context.closePath();
    context.setLineDash([]);
    context.globalAlpha = 0.5;
    context.fillStyle = paint.face;
    context.fill();
    context.globalAlpha = 1;
    context.lineWidth = 1;
    context.strokeStyle = paint.edge;
    context.stroke();
  }

  // The part of a curve on the front of the ellipsoid is opaque, the part behind it pale.
  curve(points, moments, ink, width) {
    const [, , eye] = this.axes;
    const seen = v => v.reduce((sum, x, i) => sum + x * moments[i] * eye[i], 0) >= 0;
    let run = points.slice(0, 1);
    for (const point of points.slice(1)) {
      run.push(point);
      if (seen(point) === seen(run[0]) && point !== points.at(-1)) continue;
      this.context.globalAlpha = seen(run[0]) ? 1 : 0.5;
      this.line(run, ink, width);
      run = [point];
    }
    this.context.globalAlpha = 1;
  }
}
