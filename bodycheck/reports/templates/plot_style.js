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
    exponentformat: "e",
    minorloglabels: "none",
    automargin: true,
    ...more,
  };
}

// A short logarithmic axis would have one tick label or none: label 1, 2 and 5 of each decade.
function logAxis(title, values, more) {
  const [least, most] = [Math.min(...values), Math.max(...values)];
  if (!values.length || most > 100 * least) return axis(title, { type: "log", ...more });
  const decades = [-1, 0, 1, 2].map(k => k + Math.floor(Math.log10(least)));
  const ticks = decades.flatMap(decade => [1, 2, 5].map(digit => `${digit}e${decade}`));
  const texts = ticks.map(tick => (Number(tick) < 1e-3 ? tick : String(Number(tick))));
  return axis(title, { type: "log", tickvals: ticks.map(Number), ticktext: texts, ...more });
}

// A logarithmic axis spans the selected lines, so that grey ones do not flatten them; without any, all lines.
function heightAxis(title, lines, more) {
  const values = lines.filter(({ level }) => level === "on").flatMap(({ y }) => y).filter(value => value > LEAST);
  if (!values.length) return axis(title, { type: "log", ...more });
  const ends = [Math.min(...values), Math.max(...values)];
  const [least, most] = ends.map(Math.log10);
  const margin = Math.max(0.06 * (most - least), 0.5 - 0.5 * (most - least), 0.1);
  return logAxis(title, ends, { range: [least - margin, most + margin], ...more });
}

// Room for the labels at the ends of lines; on a phone there is none.
const labelWidth = () => (matchMedia("(max-width: 40rem)").matches ? 8 : 190);

function layout(more) {
  return {
    font: { family: "system-ui, sans-serif", size: 12, color: colour("--ink") },
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: "rgba(0,0,0,0)",
    margin: { l: 52, r: labelWidth(), t: 20, b: 44 },
    showlegend: false,
    hovermode: "closest",
    dragmode: touch ? false : "zoom",
    ...more,
  };
}

// level: "on", or "grey" for thin lines in the background; rank: the number of engines drawn on top of the line
function look(m, level = "on", rank = 0, solid = false) {
  const { marker, dash } = methods[m];
  if (level === "grey") {
    return { line: { color: colour("--context"), width: 1 }, marker: { color: colour("--context"), symbol: marker, size: 5 } };
  }
  const ink = engineColour(m);
  return {
    line: { color: ink, width: 1.5 + 2.5 * rank, dash: solid ? "solid" : dash },
    marker: { color: ink, symbol: marker, size: 7 + 3 * rank },
  };
}

// Points without coordinates are open markers in a strip at the edge of the axes, one lane per method.
function marks(faults, where) {
  return faults.map(fault => ({
    ...where(fault),
    mode: "markers", hoverinfo: "text", name: plain(methods[fault.m].name),
    marker: { ...look(fault.m, fault.level).marker, symbol: `${methods[fault.m].marker}-open` },
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
const sideStrip = (faults, title = "failed") => faults.length ? {
  xaxis2: { ...strip(title), side: "top", domain: [0.9, 1], anchor: "y2" },
  yaxis2: { ...strip(""), anchor: "x2" },
} : {};
const roomForStrip = faults => (faults.length ? { domain: [0, 0.88] } : {});
function besideMarks(faults) {
  const lane = lanes(faults);
  return marks(faults, fault => ({ x: [0.5], y: [lane(fault.m)], xaxis: "x2", yaxis: "y2" }));
}

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
