// Draws the plots of a section when it comes into view, and again when a choice changes.
const dark = matchMedia("(prefers-color-scheme: dark)");

// The time that motion and drift plot of a section share is a line in the plot.
const cursorTimes = new WeakMap();

function placeCursor(plot, t) {
  const { xaxis, yaxis } = plot._fullLayout;
  const line = plot.querySelector(":scope > .cursor") ?? plot.appendChild(document.createElement("div"));
  const x = xaxis.d2p(t);
  line.className = "cursor";
  line.hidden = x < 0 || x > xaxis._length;
  Object.assign(line.style, { left: `${xaxis._offset + x}px`, top: `${yaxis._offset}px`, height: `${yaxis._length}px` });
}

function moveCursor(section, t) {
  cursorTimes.set(section, t);
  for (const plot of section.querySelectorAll("[data-plot=drift]")) if (plot._fullLayout) placeCursor(plot, t);
}

// A click at a line selects its time and its case; a plot that was zoomed or resized moves its cursor.
function followTime(plot, section) {
  plot.on("plotly_click", ({ points: [point] }) => {
    if (point.xaxis._name !== "xaxis") return; // a mark at the edge has no time
    const detail = { t: point.x, m: point.data.meta, dt: dataOf(section).dt };
    section.dispatchEvent(new CustomEvent("timechosen", { detail }));
  });
  plot.on("plotly_afterplot", () => {
    if (cursorTimes.has(section)) placeCursor(plot, cursorTimes.get(section));
  });
}

function draw(section) {
  const data = dataOf(section);
  for (const plot of section.querySelectorAll(".plot")) {
    const drift = plot.closest("figure").querySelector("select[data-choice=drift]");
    const chosen = { error: measure.selectedIndex, drift: drift?.selectedIndex };
    const { lines, traces, layout } = plots[plot.dataset.plot](data, chosen);
    Plotly.react(plot, traces, layout, config);
    if (layout.margin.r > 100) {
      Plotly.relayout(plot, { annotations: [...(layout.annotations ?? []), ...endLabels(plot, lines)] });
    }
    if (plot.dataset.plot === "drift" && plot.dataset.drawn === undefined) followTime(plot, section);
    plot.dataset.drawn = "";
  }
}

// Of the tables with one instance per error, show only the chosen one.
function showChosen() {
  for (const part of document.querySelectorAll("[data-error]")) part.hidden = part.dataset.error !== measure.value;
}

const sections = [...document.querySelectorAll("[data-section]")].filter(section => section.querySelector(".plots"));
const drawn = new Set();
showChosen();
for (const section of sections) {
  whenSeen(section.querySelector(".plots"), () => {
    drawn.add(section);
    draw(section);
  });
  for (const choice of section.querySelectorAll("select[data-choice]")) choice.addEventListener("change", () => draw(section));
}

function redraw() {
  for (const section of drawn) if (section.querySelector(".plots").getClientRects().length) draw(section);
}
dark.addEventListener("change", redraw);
addEventListener("afterprint", redraw);
addEventListener("beforeprint", redraw);
for (const part of scenarios) {
  part.addEventListener("toggle", () => {
    if (part.open && drawn.has(part.parentElement)) draw(part.parentElement); // choices may have changed meanwhile
  });
}

// The tools of a plot: larger, as SVG, its data as CSV.
function save(name, url) {
  const link = document.createElement("a");
  Object.assign(link, { download: name, href: url });
  link.click();
}

const quoted = text => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
const unescaped = text => text.replaceAll("&lt;", "<").replaceAll("&gt;", ">").replaceAll("&amp;", "&");

function csvOf(plot) {
  const { xaxis, yaxis } = plot.layout;
  const rows = plot.data.filter(trace => trace.name && trace.hoverinfo !== "skip" && !trace.xaxis && !trace.yaxis)
    .flatMap(trace => trace.x.map((x, k) => [quoted(unescaped(trace.name)), x, trace.y[k]]));
  return [["line", quoted(xaxis.title.text), quoted(yaxis.title.text)], ...rows].map(row => row.join(",")).join("\n") + "\n";
}

const tools = {
  enlarge(plot, button) {
    const large = plot.closest("figure").classList.toggle("large");
    button.setAttribute("aria-pressed", large);
    button.textContent = large ? "reduce" : "enlarge";
    draw(plot.closest("[data-section]"));
    Plotly.Plots.resize(plot);
  },
  svg: (plot, _, name) => Plotly.downloadImage(plot, { format: "svg", filename: name, width: plot.clientWidth, height: plot.clientHeight }),
  link: (_, button) => copyLink(button),
  csv(plot, _, name) {
    const url = URL.createObjectURL(new Blob([csvOf(plot)], { type: "text/csv" }));
    save(`${name}.csv`, url);
    URL.revokeObjectURL(url);
  },
};
document.addEventListener("click", event => {
  const tool = event.target.dataset?.tool;
  if (!tool) return;
  const plot = event.target.closest("figure").querySelector(".plot");
  const place = plot.closest("[data-section]").id.replace(/^scenario-/, "");
  tools[tool](plot, event.target, `${place}-${plot.dataset.plot}`);
});
