// The plots of one scenario: name -> f(data, whether shown, chosen) -> plotly's traces and layout.
const fineness = p =>
  p.dt !== null ? `dt ${p.dt} s` : p.tolerance !== null ? `tolerance ${p.tolerance}` : "no steps";

function pointText(p, error, fit) {
  return hover([
    methods[p.m].name,
    fineness(p),
    `${error.name} ${short(p.error)}`,
    fit && `order ${short(fit[0], 3)}, floor ${short(fit[1], 2)}`,
    p.cpu && `processor ${short(p.cpu[1])} s (${short(p.cpu[0])} to ${short(p.cpu[2])})`,
    p.ns !== undefined && `${short(p.ns)} ns per step`,
    p.stepping && `${p.stepping} stepping`,
  ]);
}

// The points that have the chosen error.
const having = (points, choice) =>
  points.filter(p => p.errors[choice] !== null).map(p => ({ ...p, error: p.errors[choice] }));

// C dt^order down to the floor; C from the median of the errors used for the order.
function fitLine(own, [order, floor], steps) {
  const usable = own.filter(p => p.error > 10 * floor && p.error < 0.3);
  if (!usable.length) return null;
  const logs = usable.map(p => Math.log(p.error) - order * Math.log(p.dt)).sort((a, b) => a - b);
  const level = logs[Math.floor(logs.length / 2)];
  const [from, to] = [Math.min(...steps), Math.max(...usable.map(p => p.dt))].map(Math.log);
  const x = Array.from({ length: 41 }, (_, k) => Math.exp(from + ((to - from) * k) / 40));
  return {
    mode: "lines", hoverinfo: "skip", x, y: x.map(dt => Math.max(Math.exp(level) * dt ** order, floor)),
    line: { color: engineColour(own[0].m), width: 1, dash: "dot" },
  };
}

const plots = {
  speed(data, shown, chosen) {
    const faults = data.faults.filter(shown);
    const error = data.errors[chosen.error];
    const points = having(data.points, chosen.error).filter(p => p.cpu && shown(p));
    const traces = byMethod(points).map(([m, own]) => ({
      ...look(m),
      mode: "lines+markers",
      x: own.map(p => p.cpu[1]),
      y: own.map(p => logarithmic(p.error)),
      error_x: {
        type: "data", symmetric: false, thickness: 1, width: 2,
        array: own.map(p => p.cpu[2] - p.cpu[1]), arrayminus: own.map(p => p.cpu[1] - p.cpu[0]),
      },
      text: own.map(p => pointText(p, error)),
    }));
    const front = frontOf(points.map(p => ({ x: p.cpu[1], y: logarithmic(Math.max(p.error, error.floor)) })));
    return [
      [front, ...traces, ...besideMarks(faults)],
      layout({
        xaxis: logAxis("processor time, s", points.map(p => p.cpu[1]), beside(faults)),
        yaxis: axis(zeroAtLeast(error.name), { type: "log" }),
        ...sideStrip(faults),
        ...withFloor(error.floor),
      }),
    ];
  },

  error(data, shown, chosen) {
    const faults = data.faults.filter(fault => fault.dt !== null && shown(fault));
    const error = data.errors[chosen.error];
    const steps = [...data.points, ...data.faults].map(p => p.dt).filter(dt => dt !== null);
    const points = having(data.points, chosen.error).filter(p => p.tolerance === null && shown(p)); // a tolerance is not a step
    const fits = [];
    const traces = byMethod(points).map(([m, own]) => {
      const stepless = own[0].dt === null; // one error, drawn across all steps
      const at = stepless ? [Math.min(...steps), Math.max(...steps)] : own.map(p => p.dt);
      const fit = error.fits[m];
      if (fit) fits.push(fitLine(own, fit, steps));
      return {
        ...look(m, data.ranks[m]),
        mode: "lines+markers",
        x: at,
        y: at.map((_, k) => logarithmic((own[k] ?? own[0]).error)),
        text: at.map((_, k) => pointText(own[k] ?? own[0], error, fit)),
      };
    });
    const above = faults.length ? {
      yaxis2: { ...strip("not ok"), domain: [0.86, 1], anchor: "x" },
    } : {};
    const lane = lanes(faults);
    return [
      [...traces, ...fits.filter(Boolean), ...marks(faults, fault => ({ x: [fault.dt], y: [lane(fault.m)], yaxis: "y2" }))],
      layout({
        xaxis: logAxis("step, s", steps),
        yaxis: axis(zeroAtLeast(error.name), { type: "log", domain: [0, faults.length ? 0.82 : 1] }),
        ...above,
        ...withFloor(error.floor),
      }),
    ];
  },

  drift(data, shown, chosen) {
    const drift = data.drifts[chosen.drift];
    const missing = data.missing.filter(shown);
    const lines = Object.entries(drift ? drift.lines : {}).map(([m, values]) => [Number(m), values]);
    const traces = lines.filter(([m]) => shown({ m })).map(([m, values]) => {
      const line = typeof values === "number" ? data.t.map(() => values) : floats(values); // a constant line is stored as one number
      const looks = look(m, data.ranks[m]);
      return {
        ...looks,
        mode: "lines+markers",
        marker: { ...looks.marker, maxdisplayed: 8 },
        x: data.t,
        y: line.map(logarithmic),
        text: line.map((value, k) => hover([
          methods[m].name, `${data.t[k]} s`, short(value), drift.growth[m] && `grows ${drift.growth[m]} at its finest step`,
        ])),
      };
    });
    return [
      [...traces, ...besideMarks(missing)],
      layout({
        xaxis: axis("time, s", beside(missing)),
        yaxis: axis(drift ? zeroAtLeast(drift.name) : "", { type: "log" }),
        ...sideStrip(missing),
      }),
    ];
  },
};
