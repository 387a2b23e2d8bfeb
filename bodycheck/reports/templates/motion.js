// Plays the motions of a scenario, the truth and the engines, synchronised by one slider.
const LEAST_PLAY_S = 6; // shorter motions are slowed down, longer ones sped up to at most MOST_PLAY_S
const MOST_PLAY_S = 20;

function rows(text, width) {
  const numbers = floats(text);
  return Array.from({ length: numbers.length / width }, (_, k) => numbers.slice(width * k, width * (k + 1)));
}

// omega / sqrt(2 K_truth) in body axes; for the truth it lies on the ellipsoid of inertia.
function polhode(track, truth, moments) {
  const twice = truth.omega.map(w => w.reduce((sum, x, i) => sum + moments[i] * x * x, 0));
  const least = 1e-6 * Math.max(...twice);
  return track.omega.map((w, k) => scaled(w, twice[k] > least ? 1 / Math.sqrt(twice[k]) : 0));
}

const momentum = ({ q, omega }, moments) => turned(q, omega.map((w, i) => w * moments[i]));

function prepared(data) {
  const { moments, t } = data;
  const unpacked = track => ({ ...track, q: rows(track.q, 4), omega: rows(track.omega, 3) });
  const truth = unpacked(data.truth);
  const momenta = truth.q.map((q, k) => momentum({ q, omega: truth.omega[k] }, moments));
  const largest = momenta.reduce((most, L) => (Math.hypot(...L) > Math.hypot(...most) ? L : most));
  const tracks = [{ ...truth, name: "truth" }, ...data.methods.map(track => ({ ...unpacked(track), name: methods[track.m].name }))];
  for (const track of tracks) {
    track.polhode = polhode(track, truth, moments);
    track.herpolhode = track.polhode.map((w, k) => turned(track.q[k], w));
  }
  const ahead = tracks[0].polhode.find(w => Math.hypot(...w) > 0) ?? [1, 1, 1];
  const side = [ahead[0] < 0 ? -0.7 : 0.7, ahead[1] < 0 ? -1 : 1, 0]; // so that the polhode begins in front
  const semiaxes = moments.map(moment => 1 / Math.sqrt(moment));
  return { ...data, tracks, momenta, semiaxes, world: camera(unit(largest)), body: camera([0, 0, ahead[2] < 0 ? -1 : 1], side), L: Math.hypot(...largest) };
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

function drawTrack(canvas, motion, track, t) {
  const context = canvas.getContext("2d");
  const size = canvas.clientWidth;
  const ratio = devicePixelRatio || 1;
  canvas.width = size * ratio;
  canvas.height = 2 * size * ratio;
  context.scale(ratio, ratio);
  const [truth] = motion.tracks;
  const { moments, semiaxes } = motion;
  const ink = track === truth ? colour("--ink") : engineColour(track.m);
  const faint = colour("--trace");
  const state = stateAt(track, motion.t, t);
  const now = motion.t.findLastIndex(sample => sample <= t) + 1;

  const widest = Math.max(...semiaxes);
  const world = new View(context, motion.world, size, 0, 1.05);
  const trace = points => points.map(w => scaled(w, 0.75 / widest));
  world.line(trace(truth.herpolhode), faint, 1);
  const paint = { face: colour("--none"), marked: ink, edge: colour("--faint") };
  world.box(motion.corners.map(corner => turned(state.q, corner)), paint);
  world.line(trace(track.herpolhode.slice(0, now)), ink, 1.5);
  const arrow = of => scaled(momentum(of, moments), 0.8 / motion.L);
  world.arrow(arrow(stateAt(truth, motion.t, t)), faint, 3);
  world.arrow(arrow(state), ink, 1.5);

  const body = new View(context, motion.body, size, size, 1.1 * widest);
  body.ellipsoid(semiaxes, paint);
  for (const section of sectionsOf(semiaxes)) body.curve(section, moments, colour("--line"), 1);
  body.curve(truth.polhode, moments, faint, 3);
  body.curve(track.polhode.slice(0, now), moments, ink, 1.5);
  body.dot(track.polhode[Math.max(now - 1, 0)], ink);
  return angleBetween(stateAt(truth, motion.t, t).q, state.q);
}

const off = angle => (angle < 1e-6 ? "less than 1e-6 rad off" : `${short(angle, 2)} rad off`);

function startPlayer(figure) {
  const motion = prepared(dataOf(figure));
  const slider = figure.querySelector("input[type=range]");
  const button = figure.querySelector("[data-play]");
  const clock = figure.querySelector("output");
  const last = motion.t.at(-1);
  const panels = motion.tracks.map(track => {
    const panel = figure.querySelector(".tracks").appendChild(document.createElement("div"));
    const name = panel.appendChild(document.createElement("b"));
    name.textContent = track.name;
    const canvas = panel.appendChild(document.createElement("canvas"));
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Motion and polhode of ${track.name}`);
    return { track, canvas, told: panel.appendChild(document.createElement("small")) };
  });
  let playing = 0;

  function show() {
    const t = (last * slider.value) / slider.max;
    clock.textContent = `${t.toFixed(2)} s`;
    slider.setAttribute("aria-valuetext", clock.textContent);
    panels.forEach(({ track, canvas, told }, number) => {
      const angle = drawTrack(canvas, motion, track, t);
      if (number) told.textContent = off(angle);
    });
    figure.dataset.drawn = clock.textContent;
  }

  function stop() {
    cancelAnimationFrame(playing);
    playing = 0;
    button.textContent = "play";
  }

  function play() {
    const seconds = Math.min(Math.max(last, LEAST_PLAY_S), MOST_PLAY_S);
    if (slider.valueAsNumber >= Number(slider.max)) slider.value = 0;
    const from = slider.valueAsNumber;
    let begin = null;
    const frame = now => {
      begin ??= now;
      slider.value = from + (slider.max * (now - begin)) / 1000 / seconds;
      show();
      if (slider.valueAsNumber < Number(slider.max)) playing = requestAnimationFrame(frame);
      else stop();
    };
    button.textContent = "pause";
    playing = requestAnimationFrame(frame);
  }

  button.addEventListener("click", () => (playing ? stop() : play()));
  slider.addEventListener("input", () => {
    stop();
    show();
  });
  dark.addEventListener("change", show);
  addEventListener("resize", show);
  addEventListener("beforeprint", show);
  addEventListener("afterprint", show);
  show();
}

for (const figure of document.querySelectorAll("[data-motion]")) whenSeen(figure, () => startPlayer(figure));
