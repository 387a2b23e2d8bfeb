// Draws a turning body, its momentum and its omega on a canvas: two square views, one above the other.
const FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];

const askew = v => (Math.abs(v[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]);

// The axes of a camera: right, up, and towards the eye, which is 25 degrees above the plane normal to `up`.
function camera(up, side = askew(up)) {
  const right = unit(cross(up, side));
  const eye = unit(added(scaled(up, Math.sin(0.44)), scaled(cross(right, up), Math.cos(0.44))));
  return [right, cross(eye, right), eye];
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

  // Only the faces towards the eye, darker at a larger angle to it; one pair of faces is marked.
  box(corners, paint) {
    const { context } = this;
    const [, , eye] = this.axes;
    FACES.forEach((face, number) => {
      const [a, b, , d] = face.map(i => corners[i]);
      const out = unit(cross(added(b, scaled(a, -1)), added(d, scaled(a, -1))));
      const centre = face.reduce((sum, i) => added(sum, corners[i]), [0, 0, 0]);
      const facing = dot(dot(out, centre) < 0 ? scaled(out, -1) : out, eye);
      if (facing <= 0) return;
      context.beginPath();
      face.forEach((i, k) => context[k ? "lineTo" : "moveTo"](...this.place(corners[i])));
      context.closePath();
      context.globalAlpha = 0.35 + 0.5 * facing;
      context.fillStyle = number === 1 ? paint.marked : paint.face;
      context.fill();
      context.globalAlpha = 1;
      context.setLineDash([]);
      context.lineWidth = 1;
      context.strokeStyle = paint.edge;
      context.stroke();
    });
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
