// The plot over all scenarios: error tolerance against the cost of meeting it.
plots.overall = (data, shown, chosen) => {
  const { name, points, faults } = data[chosen.error];
  const missing = faults.filter(shown);
  const kept = points.filter(p => p.cost[1] !== null && shown(p)).map(p => ({ ...p, x: p.cost[1], y: p.error }));
  const traces = byMethod(kept).map(([m, own]) => ({
    ...look(m),
    mode: "lines+markers",
    x: own.map(p => p.x),
    y: own.map(p => p.y),
    error_x: {
      type: "data", symmetric: false, thickness: 1, width: 2,
      array: own.map(p => (p.cost[2] ?? p.x) - p.x), arrayminus: own.map(p => p.x - p.cost[0]),
    },
    text: own.map(p => hover([
      methods[m].name,
      `${name} at most ${p.y}`,
      `${short(p.x)} CPU s per simulated s (${short(p.cost[0])} to ${p.cost[2] === null ? "not met" : short(p.cost[2])})`,
      `in ${p.kept} of ${p.scenarios} scenarios`,
    ])),
  }));
  return [
    [frontOf(kept), ...traces, ...besideMarks(missing)],
    layout({
      xaxis: logAxis("CPU seconds per simulated second", kept.map(p => p.x), beside(missing)),
      yaxis: axis(`tolerance of ${name}`, { type: "log" }),
      ...sideStrip(missing, "met nowhere"),
    }),
  ];
};
