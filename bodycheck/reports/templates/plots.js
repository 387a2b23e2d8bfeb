// The plots of one scenario: name -> f(data, chosen) -> traces, layout, and the lines that get labels.
const fineness = p =>
  p.dt !== null ? `dt ${p.dt} s` : p.tolerance ? `tolerance ${p.tolerance}` : "no steps";

function pointText(p, name, error, fit) {
  return hover([
    name,
    fineness(p),
    `${error.title} ${short(p.error)}`,
    fit && `order ${short(fit[0], 3)}, floor ${short(fit[1], 2)}`,
    p.cpu && `processor ${short(p.cpu[1])} s (${short(p.cpu[0])} to ${short(p.cpu[2])})`,
    p.ns !== undefined && `${short(p.ns)} ns per step`,
    p.stepping && `${p.stepping} stepping`,
  ]);
}

// The points that have the chosen error, by method, each with the level at which the legend shows it.
function linesOf(points, choice, fits) {
  const usable = points.filter(p => p.errors[choice] !== null && levelOf(p.m) && fits(p));
  const by = Map.groupBy(usable.map(p => ({ ...p, error: p.errors[choice] })), p => p.m);
  return [...by].map(([m, own]) => ({ m, own, level: levelOf(m) }));
}
const marked = faults => faults.map(fault => ({ ...fault, level: levelOf(fault.m) })).filter(fault => fault.level === "on");

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

// A ring around the best step of a method: finer steps are no better, because of round-off.
function bestStep(m, [dt, error, floor]) {
  return {
    mode: "markers", name: "best step", x: [dt], y: [logarithmic(error)], hoverinfo: "text",
    text: [hover([methods[m].name, `best step ${dt} s`, `error ${short(error)}`, `round-off floor ${short(floor, 2)}`])],
    marker: { symbol: "circle-open", size: 17, color: engineColour(m), line: { width: 2 } },
  };
}

const plots = {
  speed(data, chosen) {
    const faults = marked(data.faults);
    const error = data.errors[chosen.error];
    const lines = linesOf(data.points, chosen.error, p => p.cpu).map(line => ({
      ...line, members: [line.m], x: line.own.map(p => p.cpu[1]), y: line.own.map(p => logarithmic(p.error)),
    }));
    const traces = stacked(lines, line => ({
      error_x: line.level === "on" ? {
        type: "data", symmetric: false, thickness: 1, width: 2,
        array: line.own.map(p => p.cpu[2] - p.cpu[1]), arrayminus: line.own.map(p => p.cpu[1] - p.cpu[0]),
      } : undefined,
      text: line.own.map(p => pointText(p, methods[p.m].name, error)),
    }));
    const points = lines.flatMap(line => line.own);
    const front = frontOf(points.map(p => ({ x: p.cpu[1], y: logarithmic(Math.max(p.error, error.floor)) })));
    return {
      lines,
      traces: [front, ...traces, ...besideMarks(faults)],
      layout: layout({
        xaxis: logAxis("CPU time, s", points.map(p => p.cpu[1]), roomForStrip(faults)),
        yaxis: heightAxis(error.title, lines),
        ...sideStrip(faults),
        ...withFloor(error.floor),
      }),
    };
  },

  error(data, chosen) {
    const faults = marked(data.faults.filter(fault => fault.dt !== null));
    const error = data.errors[chosen.error];
    const steps = [...data.points, ...data.faults].map(p => p.dt).filter(dt => dt !== null);
    const across = [Math.max(...steps), Math.min(...steps)];
    const all = linesOf(data.points, chosen.error, p => !p.tolerance).map(line => { // a tolerance is not a step
      const { own } = line;
      const stepless = own[0].dt === null; // one error, drawn across all steps
      return {
        ...line,
        x: stepless ? across : own.map(p => p.dt),
        y: (stepless ? [own[0], own[0]] : own).map(p => logarithmic(p.error)),
      };
    });
    const lines = merged(all, error.floor);
    const fits = lines.filter(line => line.level === "on" && error.fits[line.m])
      .map(line => fitLine(line.own, error.fits[line.m], steps));
    const traces = stacked(lines, line => ({
      text: line.x.map((_, k) => pointText(line.own[k] ?? line.own[0], fullName(line), error, error.fits[line.m])),
    }));
    const lane = lanes(faults);
    const above = faults.length ? { yaxis2: { ...strip("failed"), domain: [0.86, 1], anchor: "x" } } : {};
    const best = lines.filter(line => line.level === "on" && error.best[line.m])
      .map(line => bestStep(line.m, error.best[line.m]));
    return {
      lines,
      traces: [...traces, ...fits.filter(Boolean), ...best, ...marks(faults, fault => ({ x: [fault.dt], y: [lane(fault.m)], yaxis: "y2" }))],
      layout: layout({
        xaxis: logAxis("step, s (finer to the right)", steps, { autorange: "reversed" }),
        yaxis: heightAxis(error.title, lines, { domain: [0, faults.length ? 0.82 : 1] }),
        ...above,
        ...withFloor(error.floor),
      }),
    };
  },

  drift(data, chosen) {
    const drift = data.drifts[chosen.drift];
    const missing = marked(data.missing);
    const valuesOf = stored => { // a constant line is one number, a line equal to an earlier one [its method]
      if (Array.isArray(stored)) return valuesOf(drift.lines[stored[0]]);
      return (typeof stored === "number" ? data.t.map(() => stored) : lineValues(stored)).map(logarithmic);
    };
    const all = Object.entries(drift ? drift.lines : {})
      .map(([m, stored]) => ({ m: Number(m), level: levelOf(m), x: data.t, y: valuesOf(stored) }));
    const lines = merged(all.filter(line => line.level), LEAST);
    const moved = lines.map(line => ({ ...line, y: line.y.slice(1) })); // at the start there is only round-off
    const traces = stacked(lines, line => ({
      mode: "lines",
      text: line.y.map((value, k) => hover([
        fullName(line), `${data.t[k]} s`, value === LEAST ? "0" : short(value, 3), drift.growth[line.m] && `grows ${drift.growth[line.m]} at its finest step`,
      ])),
    }));
    return {
      lines,
      traces: [...traces, ...besideMarks(missing)],
      layout: layout({
        xaxis: axis("time, s", roomForStrip(missing)),
        yaxis: heightAxis(drift ? drift.title : "", moved),
        ...sideStrip(missing),
      }),
    };
  },
};
