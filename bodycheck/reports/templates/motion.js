// Plays the motions of a scenario, the truth and any of its cases, synchronised by one time.
const MIN_PLAY_S = 6; // shorter motions are slowed down, longer ones sped up to at most MAX_PLAY_S
const MAX_PLAY_S = 20;
const TURN_PER_PX = 0.01; // rad, of the view
const TURN_PER_KEY = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };

// Numbers in [-scale, scale] are stored as base64 of little-endian int16.
function rows(text, width, scale) {
  const bytes = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  return Array.from({ length: bytes.length / 2 / width }, (_, k) =>
    Array.from({ length: width }, (_, i) => (scale * view.getInt16(2 * (width * k + i), true)) / 32767));
}

// omega / sqrt(2 K_truth) in body axes; for the truth it lies on the ellipsoid of inertia.
function polhode(track, truth, moments) {
  const twice = truth.omega.map(w => w.reduce((sum, x, i) => sum + moments[i] * x * x, 0));
  const least = 1e-6 * Math.max(...twice);
  return track.omega.map((w, k) => scaled(w, twice[k] > least ? 1 / Math.sqrt(twice[k]) : 0));
}

const momentum = ({ q, omega }, moments) => turned(q, omega.map((w, i) => w * moments[i]));

// A stored track with its states, and omega in body and in world axes.
function unpacked(stored, truth, moments) {
  const track = { ...stored, q: rows(stored.q, 4, 1), omega: rows(stored.omega, 3, stored.fastest) };
  track.polhode = polhode(track, truth ?? track, moments);
  track.herpolhode = track.polhode.map((w, k) => turned(track.q[k], w));
  return track;
}

// A track of a tree: the states of each body, with its places.
const treeTrack = stored => ({
  ...stored,
  bodies: stored.bodies.map(({ q, omega, x }) => ({ q: rows(q, 4, 1), omega: rows(omega, 3, stored.fastest), x: rows(x, 3, stored.far) })),
});

const stepOf = ({ dt }) => dt === null ? [] : [`dt ${dt} s`];

const named = (stored, t) => ({
  name: [methods[stored.m].name, ...stepOf(stored)].join(", "),
  error: typeof stored.error === "number" ? t.map(() => stored.error) : lineValues(stored.error),
});

function preparedTree(data) {
  const tracks = data.tracks.map(stored => ({ ...treeTrack(stored), ...named(stored, data.t) }));
  const surfaces = data.parts.map(part => ({ ...surfaceOf(part), sticks: part.sticks }));
  return { ...data, surfaces, truth: { ...treeTrack(data.truth), name: "truth" }, tracks, world: camera([0, 0, 1]), inside: camera([0, 0, 1]) };
}

function prepared(data) {
  if (data.parts) return preparedTree(data);
  const { moments, t } = data;
  const truth = { ...unpacked(data.truth, null, moments), name: "truth" };
  const momenta = truth.q.map((q, k) => momentum({ q, omega: truth.omega[k] }, moments));
  const largest = momenta.reduce((most, L) => (Math.hypot(...L) > Math.hypot(...most) ? L : most));
  const tracks = data.tracks.map(stored => ({
    ...unpacked(stored, truth, moments),
    ...named(stored, t),
  }));
  const ahead = truth.polhode.find(w => Math.hypot(...w) > 0) ?? [1, 1, 1];
  const side = [ahead[0] < 0 ? -0.7 : 0.7, ahead[1] < 0 ? -1 : 1, 0]; // so that the polhode begins in front
  const semiaxes = moments.map(moment => 1 / Math.sqrt(moment));
  return { ...data, surface: surfaceOf(data.body), truth, tracks, semiaxes, world: camera(unit(largest)), inside: camera([0, 0, ahead[2] < 0 ? -1 : 1], side), L: Math.hypot(...largest) };
}

// The three principal sections of the ellipsoid of inertia.
function sectionsOf(semiaxes) {
  const circle = Array.from({ length: 49 }, (_, k) => (2 * Math.PI * k) / 48);
  return [[0, 1], [1, 2], [2, 0]].map(([i, j]) => circle.map(angle => {
    const v = [0, 0, 0];
    v[i] = semiaxes[i] * Math.cos(angle);
    v[j] = semiaxes[j] * Math.sin(angle);
    return v;
  }));
}

// Each body of a tree at a time, farthest from the eye first: its surface and sticks, moved into place.
function posedTree(motion, track, t) {
  const { surfaces, world: [, , eye] } = motion;
  return surfaces.map((surface, k) => {
    const part = track.bodies[k];
    const { q } = stateAt(part, motion.t, t);
    const n = Math.min(Math.max(motion.t.findLastIndex(sample => sample <= t), 0), motion.t.length - 2);
    const share = Math.min(Math.max((t - motion.t[n]) / (motion.t[n + 1] - motion.t[n]), 0), 1);
    const x = added(scaled(part.x[n], 1 - share), scaled(part.x[n + 1], share));
    const there = posed(surface, q);
    const sticks = allTurned(q, surface.sticks).map(end => [x, added(x, end)]);
    return { ...there, corners: there.corners.map(corner => added(corner, x)), sticks, depth: dot(x, eye) };
  }).sort((a, b) => a.depth - b.depth);
}

// The coordinates of the joints over time, up to now, one strip each, the truth in grey.
function drawJoints(context, motion, track, size, now) {
  const all = motion.joints.length;
  motion.joints.forEach((name, k) => {
    const [top, high] = [size + (size * k) / all, size / all];
    const values = [...motion.truth.joints[k], ...(track.joints[k] ?? [])];
    const [low, most] = [Math.min(...values), Math.max(...values)];
    const place = (value, n) => [(size * motion.t[n]) / motion.t.at(-1), top + high * (0.9 - (0.65 * (value - low)) / (most - low || 1))];
    const curve = (line, ink, width) => {
      context.beginPath();
      line.forEach((value, n) => context[n ? "lineTo" : "moveTo"](...place(value, n)));
      context.setLineDash([]);
      context.strokeStyle = ink;
      context.lineWidth = width;
      context.stroke();
    };
    curve(motion.truth.joints[k], colour("--truth"), 3);
    if (track.joints[k]) curve(track.joints[k].slice(0, now), track === motion.truth ? colour("--truth") : engineColour(track.m), 1.5);
    context.fillStyle = colour("--ink");
    context.font = "11px sans-serif";
    context.fillText(`${name.replace(/\.(\w+)$/, ", $1")}: ${short(low, 3)} to ${short(most, 3)}`, 4, top + 12);
  });
}

const paintOf = (ink, isTruth) => ({ paper: colour("--paper"), ink, edge: ink, dash: isTruth ? TRUTH_DASH : [] });

function drawTree(context, motion, track, size, t) {
  const { truth } = motion;
  const [ink, faint] = [track === truth ? colour("--truth") : engineColour(track.m), colour("--truth")];
  const world = new View(context, motion.world, size, 0, motion.reach);
  for (const part of posedTree(motion, track, t)) {
    for (const stick of part.sticks) world.line(stick, ink, 3);
    world.body(part, paintOf(ink, track === truth));
  }
  if (track !== truth) {
    for (const part of posedTree(motion, truth, t)) {
      world.ghost(part, faint);
      for (const stick of part.sticks) world.line(stick, faint, 1.25, TRUTH_DASH);
    }
  }
  drawJoints(context, motion, track, size, motion.t.findLastIndex(sample => sample <= t) + 1);
}

function drawTrack(canvas, motion, track, t) {
  const context = canvas.getContext("2d");
  const size = canvas.clientWidth;
  const ratio = devicePixelRatio || 1;
  canvas.width = size * ratio;
  canvas.height = 2 * size * ratio;
  context.scale(ratio, ratio);
  if (motion.parts) {
    drawTree(context, motion, track, size, t);
    return;
  }
  const { truth, moments, semiaxes } = motion;
  const ink = track === truth ? colour("--truth") : engineColour(track.m);
  const faint = colour("--truth");
  const state = stateAt(track, motion.t, t);
  const ghost = stateAt(truth, motion.t, t);
  const now = motion.t.findLastIndex(sample => sample <= t) + 1;

  const widest = Math.max(...semiaxes);
  const world = new View(context, motion.world, size, 0, 1.05);
  const trace = points => points.map(w => scaled(w, 0.75 / widest));
  world.line(trace(truth.herpolhode), faint, 1);
  world.body(posed(motion.surface, state.q), paintOf(ink, track === truth));
  if (track !== truth) world.ghost(posed(motion.surface, ghost.q), faint);
  world.line(trace(track.herpolhode.slice(0, now)), ink, 1.5);
  const arrow = of => scaled(momentum(of, moments), 0.8 / motion.L);
  world.arrow(arrow(ghost), faint, 3);
  world.arrow(arrow(state), ink, 1.5);

  const body = new View(context, motion.inside, size, size, 1.1 * widest);
  body.ellipsoid(semiaxes, { face: colour("--none"), edge: colour("--faint") });
  for (const section of sectionsOf(semiaxes)) body.curve(section, moments, colour("--line"), 1);
  body.curve(truth.polhode, moments, faint, 3);
  body.curve(track.polhode.slice(0, now), moments, ink, 1.5);
  body.dot(track.polhode[Math.max(now - 1, 0)], ink);
}

// The error at a time between two samples.
function errorAt({ error }, times, t) {
  const k = Math.min(Math.max(times.findLastIndex(sample => sample <= t), 0), times.length - 2);
  const part = Math.min(Math.max((t - times[k]) / (times[k + 1] - times[k]), 0), 1);
  return (1 - part) * error[k] + part * error[k + 1];
}

// A select of all tracks, grouped by engine.
function trackSelect(tracks, shown) {
  const select = document.createElement("select");
  for (const [engine, own] of Map.groupBy(tracks.toSorted((a, b) => a.m - b.m || b.dt - a.dt), track => methods[track.m].engine)) {
    const group = select.appendChild(document.createElement("optgroup"));
    group.label = engine;
    for (const track of own) group.append(new Option(track.name, tracks.indexOf(track), track === shown, track === shown));
  }
  return select;
}

// Fills a panel, whose place the page reserves so that drawing moves nothing.
function newPanel(panel, motion, track) {
  const [head, canvas] = panel.children;
  const select = track === motion.truth ? document.createElement("b") : trackSelect(motion.tracks, track);
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  head.append(select);
  if (track === motion.truth) select.textContent = track.name;
  return { track, select, canvas, error: head.appendChild(document.createElement("small")) };
}

function startPlayer(figure) {
  const motion = prepared(dataOf(figure));
  const { t: times, truth, tracks, farthest } = motion;
  const section = figure.closest("[data-section]");
  const slider = figure.querySelector("input[type=range]");
  const button = figure.querySelector("[data-play]");
  const clock = figure.querySelector("output");
  const speed = figure.querySelector("[data-speed]");
  const loop = figure.querySelector("[data-loop]");
  const link = figure.querySelector("[data-link]");
  const last = times.at(-1);
  const first = tracks.filter((track, k) => tracks.findIndex(({ m }) => methods[m].engine === methods[track.m].engine) === k);
  const places = figure.querySelectorAll(".tracks > div");
  const panels = [truth, ...first].map((track, k) => newPanel(places[k], motion, track));
  let playing = 0;
  let t = 0;

  function show() {
    slider.value = (slider.max * t) / last;
    clock.textContent = `${t.toFixed(2)} s`;
    slider.setAttribute("aria-valuetext", clock.textContent);
    for (const { track, canvas, error } of panels) {
      canvas.setAttribute("aria-label", `Motion and polhode of ${track.name}; arrow keys rotate the view, space plays`);
      drawTrack(canvas, motion, track, t);
      if (track !== truth) error.textContent = [...stepOf(track), `${short(errorAt(track, times, t), 2)} rad off`].join(", ");
    }
    moveCursor(section, t);
    figure.dataset.drawn = clock.textContent;
  }

  function goTo(time) {
    stop();
    t = Math.min(Math.max(time, 0), last);
    show();
  }

  function keepTime() { // in the address
    state.set("time", `${section.id}@${Number(t.toPrecision(6))}`);
  }

  function stop() {
    cancelAnimationFrame(playing);
    playing = 0;
    button.textContent = "play";
  }

  function play() {
    const seconds = Math.min(Math.max(last, MIN_PLAY_S), MAX_PLAY_S);
    if (t >= last || t === farthest.t) t = 0; // where the view opens is no beginning
    let before = null;
    const frame = now => {
      t += (((now - (before ?? now)) / 1000) * Number(speed.value) * last) / seconds;
      before = now;
      const ended = t >= last && !loop.checked;
      t = ended ? last : t % last;
      show();
      if (ended) stop();
      else playing = requestAnimationFrame(frame);
    };
    button.textContent = "pause";
    playing = requestAnimationFrame(frame);
  }
  const toggle = () => (playing ? stop() : play());

  // The upper half of a canvas is seen by one camera, the lower half by the other, in all panels alike.
  function turnView(name, yaw, pitch) {
    motion[name] = orbited(motion[name], yaw, pitch);
    show();
  }

  for (const panel of panels) {
    const { canvas, select } = panel;
    let half = null;
    canvas.addEventListener("pointerdown", event => {
      half = event.offsetY < canvas.clientHeight / 2 ? "world" : "inside";
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", event => {
      if (half) turnView(half, TURN_PER_PX * event.movementX, -TURN_PER_PX * event.movementY);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { half = null; });
    canvas.addEventListener("keydown", event => {
      const turn = TURN_PER_KEY[event.key];
      if (!turn && event.key !== " ") return;
      event.preventDefault();
      if (turn) for (const name of ["world", "inside"]) turnView(name, ...turn);
      else toggle();
    });
    if (panel.track === truth) continue;
    select.setAttribute("aria-label", `Motion in panel ${panels.indexOf(panel)}`);
    select.addEventListener("change", () => {
      panel.track = tracks[select.value];
      show();
    });
  }

  button.addEventListener("click", toggle);
  slider.addEventListener("input", () => goTo((last * slider.value) / slider.max));
  slider.addEventListener("change", keepTime);
  link.addEventListener("click", () => {
    stop();
    keepTime();
    copyLink(link);
  });
  dark.addEventListener("change", show);
  addEventListener("resize", show);
  addEventListener("beforeprint", show);
  addEventListener("afterprint", show);
  const [place, stored] = (state.get("time") ?? "").split("@");
  goTo(place === section.id ? Number(stored) || 0 : farthest.t);

  return {
    // Shows a time that was chosen in a plot, and in the panel of its engine the case whose line it was.
    choose(time, m, dt) {
      const found = tracks.findIndex(track => track.m === m && track.dt === dt);
      const panel = panels.find(({ track }) => track !== truth && methods[track.m].engine === methods[m].engine);
      if (found >= 0 && panel) {
        panel.track = tracks[found];
        panel.select.value = found;
      }
      goTo(time);
      keepTime();
      figure.scrollIntoView({ block: "nearest" });
    },
  };
}

for (const figure of document.querySelectorAll("[data-motion]")) {
  let player = null;
  const started = () => (player ??= startPlayer(figure));
  whenSeen(figure, started);
  figure.closest("[data-section]").addEventListener("timechosen", ({ detail: { t, m, dt } }) => started().choose(t, m, dt));
}
