// The plot over all scenarios: error tolerance against the cost of meeting it.
plots.overall = (data, chosen) => {
  const { title, points, faults } = data[chosen.error];
  const missing = marked(faults);
  const drawn = points.filter(p => p.cost[1] !== null && levelOf(p.m)).map(p => ({ ...p, x: p.cost[1], y: p.error }));
  const lines = [...Map.groupBy(drawn, p => p.m)].map(([m, own]) => ({
    m, own, level: levelOf(m), members: [m], x: own.map(p => p.x), y: own.map(p => p.y),
  }));
  const traces = stacked(lines, line => ({
    error_x: line.level === "on" ? {
      type: "data", symmetric: false, thickness: 1, width: 2,
      array: line.own.map(p => (p.cost[2] ?? p.x) - p.x), arrayminus: line.own.map(p => p.x - p.cost[0]),
    } : undefined,
    text: line.own.map(p => hover([
      methods[p.m].name,
      `${title} at most ${p.y}`,
      `${short(p.x)} CPU s per simulated s (${short(p.cost[0])} to ${p.cost[2] === null ? "not met" : short(p.cost[2])})`,
      `in ${p.met} of ${p.scenarios} scenarios`,
    ])),
  }));
  return {
    lines,
    traces: [frontOf(drawn), ...traces, ...besideMarks(missing)],
    layout: layout({
      xaxis: logAxis("CPU seconds per simulated second", drawn.map(p => p.x), roomForStrip(missing)),
      yaxis: heightAxis(`tolerance: ${title}`, lines),
      ...sideStrip(missing, "unmet"),
    }),
  };
};
