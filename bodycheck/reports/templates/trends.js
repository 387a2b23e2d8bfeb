// The history of one measure: a line per step, its level, the releases, and the runs in which it was worse.
const data = JSON.parse(document.getElementById("data").textContent);
const [method, scenario, measure] = ["m", "s", "q"].map(id => document.getElementById(id));
const plot = document.getElementById("plot");
const caption = document.getElementById("caption");
const colour = name => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const unique = values => [...new Set(values)];
const DAY = 864e5;

function fill(select, values, chosen, title = value => value) {
  select.replaceChildren(...values.map(value => new Option(title(value), value)));
  select.value = values.includes(chosen) ? chosen : values[0];
}

// The choices that have data: the scenarios of the method, and their measures.
function choose(m, s, q) {
  fill(method, unique(data.series.map(one => one.m)).sort(), m);
  const own = data.series.filter(one => one.m === method.value);
  fill(scenario, unique(own.map(one => one.s)).sort(), s);
  const here = own.filter(one => one.s === scenario.value);
  fill(measure, unique(here.map(one => one.q)), q, name => data.labels[name]);
  draw(here.filter(one => one.q === measure.value));
}

// Values of consecutive equal runs are stored once.
const points = one => one.v.flatMap(([first, count, value]) => Array.from({ length: count }, (_, k) => [first + k, value]));

// Values near each other have a linear axis: a logarithmic one would have no tick between them.
function valueAxis(title, values) {
  const [least, most] = [Math.min(...values), Math.max(...values)];
  if (!(least > 0) || measure.value === "order") return axis(title);
  if (most > 2 * least) return logAxis(title, values);
  const margin = Math.max(0.1 * (most - least), 0.005 * least); // so that rounding errors look like none
  return axis(title, { range: [least - margin, most + margin] });
}

function draw(chosen) {
  const engine = method.value.split(":").slice(0, -1).join(":");
  const traces = chosen.flatMap((one, index) => {
    const found = points(one);
    const line = { color: colour(`--engine-${data.colours[engine]}`), width: 1.5 };
    const value = {
      mode: "lines+markers", name: one.f, x: found.map(([run]) => data.dates[run]), y: found.map(([, y]) => y),
      customdata: found.map(([run]) => data.runs[run]), line, marker: { size: 7, symbol: data.markers[index % data.markers.length] },
      hovertemplate: `%{y:.4g}<br>${one.f}<br>%{customdata}<extra></extra>`,
    };
    if (!one.l) return [value];
    const steps = [...one.l, [data.dates.length - 1, one.l.at(-1)[1]]];
    const accepted = {
      mode: "lines", x: steps.map(([run]) => data.dates[run]), y: steps.map(([, level]) => level),
      hoverinfo: "skip", showlegend: false, line: { ...line, shape: "hv", dash: "dash", width: 1 },
    };
    return [value, accepted];
  });
  const half = at => new Date(at).toISOString();
  const worse = unique(chosen.flatMap(one => one.w ?? []));
  const time = data.dates.map(date => Date.parse(date));
  const shaded = worse.map(run => ({
    type: "rect", yref: "paper", y0: 0, y1: 1, layer: "below", line: { width: 0 }, fillcolor: colour("--bad"), opacity: 0.6,
    x0: half(run ? (time[run] + time[run - 1]) / 2 : time[run] - DAY / 2),
    x1: half(run + 1 < time.length ? (time[run] + time[run + 1]) / 2 : time[run] + (run ? time[run] - time[run - 1] : DAY) / 2),
  }));
  const releases = data.releases[engine] ?? [];
  const marks = releases.map(([run]) => ({
    type: "line", yref: "paper", y0: 0, y1: 1, x0: data.dates[run], x1: data.dates[run], line: { color: colour("--faint"), width: 1, dash: "dot" },
  }));
  const title = data.labels[measure.value];
  const state = worse.length ? `worse than its level in ${worse.length} of ${data.runs.length} nightly runs` : "never worse than its level";
  caption.textContent = `${title} of ${method.value} on ${scenario.value}: ${chosen.some(one => one.l) ? state : "without a level"}`;
  Plotly.react(plot, traces, {
    font: { family: "system-ui, sans-serif", size: 12, color: colour("--ink") },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)",
    margin: { l: 60, r: 16, t: 24, b: 40 }, hovermode: "closest", dragmode: "zoom",
    legend: { orientation: "h", y: -0.18 }, showlegend: true,
    xaxis: { type: "date", gridcolor: colour("--grid"), linecolor: colour("--line") },
    yaxis: valueAxis(title, chosen.flatMap(one => [...one.v.map(([, , value]) => value), ...(one.l ?? []).map(([, level]) => level)])),
    shapes: [...shaded, ...marks],
    annotations: releases.map(([run, version]) => ({
      text: version, x: data.dates[run], xanchor: "left", yref: "paper", y: 1, yanchor: "bottom", showarrow: false, font: { size: 11 },
    })),
  }, { responsive: true, displayModeBar: false });
}

const fromAddress = () => choose(...decodeURIComponent(location.hash.slice(1) || data.start).split("|"));
for (const select of [method, scenario, measure]) {
  select.addEventListener("change", () => {
    history.replaceState(null, "", `#${[method, scenario, measure].map(one => encodeURIComponent(one.value)).join("|")}`);
    choose(method.value, scenario.value, measure.value);
  });
}
addEventListener("hashchange", fromAddress);
fromAddress();
plot.on("plotly_click", ({ points: [point] }) => { if (point.customdata) location.href = `${point.customdata}/night.html`; });
