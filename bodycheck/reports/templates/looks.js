// The style of plots: axes, lines, and the strip at the edge for points without coordinates.
const LEAST = 1e-17; // stands for 0 on a logarithmic axis
const touch = matchMedia("(pointer: coarse)").matches;
const config = {
  responsive: true,
  displayModeBar: false, // it would cover the data; a double click resets the zoom
};
const logarithmic = value => Math.max(value, LEAST);

// Plotly interprets some HTML in texts; names must stay plain text.
const plain = text => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
const hover = parts => parts.filter(Boolean).map(plain).join("<br>");

function axis(title, more) {
  return {
    title: { text: title, standoff: 6 },
    gridcolor: colour("--grid"),
    linecolor: colour("--line"),
    zeroline: false,
    exponentformat: "power",
    minorloglabels: "none",
    automargin: true,
    ...more,
  };
}

// A short logarithmic axis would have one tick label or none: label 1, 2 and 5 of each decade.
function logAxis(title, values, more) {
  const [least, most] = [Math.min(...values), Math.max(...values)];
  if (!values.length || most > 30 * least) return axis(title, { type: "log", ...more });
  const decades = [-1, 0, 1, 2].map(k => k + Math.floor(Math.log10(least)));
  const ticks = decades.flatMap(decade => [1, 2, 5].map(digit => `${digit}e${decade}`));
  const texts = ticks.map(tick => (Number(tick) < 1e-3 ? tick : String(Number(tick))));
  return axis(title, { type: "log", tickvals: ticks.map(Number), ticktext: texts, ...more });
}

function layout(more) {
  return {
    font: { family: "system-ui, sans-serif", size: 12, color: colour("--ink") },
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    margin: { l: 48, r: 8, t: 20, b: 40 },
    showlegend: false,
    hovermode: "closest",
    dragmode: touch ? false : "zoom",
    ...more,
  };
}

// rank: the number of engines that are drawn on top of this line
function look(m, rank = 0) {
  const { marker, dash } = methods[m];
  const ink = engineColour(m);
  return {
    name: plain(methods[m].name),
    line: { color: ink, width: 1.5 + 1.5 * rank, dash },
    marker: { color: ink, symbol: marker, size: 7 + 3 * rank },
    hoverinfo: "text",
  };
}

// Points without coordinates are open markers in a strip at the edge of the axes, one lane per method.
function marks(faults, where) {
  return faults.map(fault => ({
    ...look(fault.m),
    ...where(fault),
    mode: "markers",
    marker: { ...look(fault.m).marker, symbol: `${methods[fault.m].marker}-open` },
    text: hover([methods[fault.m].name, fault.dt && `dt ${fault.dt} s`, fault.outcome, fault.message]),
  }));
}
function lanes(faults) {
  const faulty = [...new Set(faults.map(fault => fault.m))];
  return m => (faulty.indexOf(m) + 0.5) / faulty.length;
}
const strip = title => ({
  title: { text: title, standoff: 4 }, range: [0, 1],
  showgrid: false, showticklabels: false, zeroline: false, fixedrange: true,
});
const sideStrip = (faults, title = "not ok") => faults.length ? {
  xaxis2: { ...strip(title), side: "top", domain: [0.9, 1], anchor: "y2" },
  yaxis2: { ...strip(""), anchor: "x2" },
} : {};
const beside = faults => (faults.length ? { domain: [0, 0.88] } : {});
function besideMarks(faults) {
  const lane = lanes(faults);
  return marks(faults, fault => ({ x: [0.5], y: [lane(fault.m)], xaxis: "x2", yaxis: "y2" }));
}

const zeroAtLeast = name => `${name}; 0 at ${LEAST}`;
const floorLine = floor => ({
  type: "line", xref: "x domain", x0: 0, x1: 1, y0: floor, y1: floor,
  line: { color: colour("--faint"), width: 1, dash: "dash" },
});
const floorLabel = floor => ({
  xref: "x domain", x: 1, xanchor: "right", y: Math.log10(floor), yanchor: "bottom", showarrow: false,
  text: `floor ${short(floor, 2)}`, font: { size: 11, color: colour("--faint") },
});
const withFloor = floor => ({ shapes: [floorLine(floor)], annotations: [floorLabel(floor)] });

// The Pareto front of the points in x and y, as a staircase below the lines.
function frontOf(points) {
  let least = Infinity;
  const ahead = points.toSorted((a, b) => a.x - b.x || a.y - b.y).filter(p => p.y < least && ((least = p.y), true));
  return {
    mode: "lines", hoverinfo: "skip", x: ahead.map(p => p.x), y: ahead.map(p => p.y),
    line: { color: colour("--front"), width: 8, shape: "hv" },
  };
}

function byMethod(points) {
  const present = [...new Set(points.map(p => p.m))];
  return present.map(m => [m, points.filter(p => p.m === m)]);
}
