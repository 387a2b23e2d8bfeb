// Draws the plots of a section when it comes into view, and again when a choice changes.
"use strict";
(() => {
  const LEAST = 1e-17; // a logarithmic axis has no place for 0
  const root = document.documentElement;
  const methods = JSON.parse(document.getElementById("methods-data").textContent);
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const touch = matchMedia("(pointer: coarse)").matches;
  const config = {
    responsive: true,
    displayModeBar: false, // it would lie on the data; a double click takes a zoom back
  };

  const colour = name => getComputedStyle(root).getPropertyValue(name).trim();
  const logarithmic = value => Math.max(value, LEAST);
  const short = (value, digits = 4) => String(Number(value.toPrecision(digits)));

  // A line comes as one constant, or as the base64 of its float32 values.
  function unpacked(line, length) {
    if (typeof line === "number") return new Array(length).fill(line);
    const bytes = Uint8Array.from(atob(line), letter => letter.charCodeAt(0));
    const view = new DataView(bytes.buffer);
    return Array.from({ length }, (_, k) => view.getFloat32(4 * k, true));
  }

  // Plotly reads some HTML in texts; a name must stay text.
  const plain = text => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
  const hover = parts => parts.filter(Boolean).map(plain).join("<br>");

  function axis(title, more) {
    return {
      title: { text: title, standoff: 6 },
      gridcolor: colour("--grid"),
      linecolor: colour("--line"),
      zeroline: false,
      exponentformat: "power",
      automargin: true,
      ...more,
    };
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

  // rank: how many engines will be drawn on top of this line
  function look(m, rank = 0) {
    const { colour: number, marker, dash } = methods[m];
    const ink = colour(`--engine-${number}`);
    return {
      name: plain(methods[m].name),
      line: { color: ink, width: 1.5 + 1.5 * rank, dash },
      marker: { color: ink, symbol: marker, size: 7 + 3 * rank },
      hoverinfo: "text",
    };
  }

  // What has no place on the axes stands in a strip of its own at their edge: open marks, one lane a method.
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
  const sideStrip = faults => faults.length ? {
    xaxis2: { ...strip("not ok"), side: "top", domain: [0.9, 1], anchor: "y2" },
    yaxis2: { ...strip(""), anchor: "x2" },
  } : {};
  const beside = faults => (faults.length ? { domain: [0, 0.88] } : {});
  function besideMarks(faults) {
    const lane = lanes(faults);
    return marks(faults, fault => ({ x: [0.5], y: [lane(fault.m)], xaxis: "x2", yaxis: "y2" }));
  }

  const errorTitle = `orientation error, rad; 0 at ${LEAST}`;
  const floorLine = floor => ({
    type: "line", xref: "x domain", x0: 0, x1: 1, y0: floor, y1: floor,
    line: { color: colour("--faint"), width: 1, dash: "dash" },
  });
  const floorLabel = floor => ({
    xref: "x domain", x: 1, xanchor: "right", y: Math.log10(floor), yanchor: "bottom", showarrow: false,
    text: `floor ${short(floor, 2)}`, font: { size: 11, color: colour("--faint") },
  });
  const withFloor = floor => ({ shapes: [floorLine(floor)], annotations: [floorLabel(floor)] });

  const fineness = p =>
    p.dt !== null ? `dt ${p.dt} s` : p.tolerance !== null ? `tolerance ${p.tolerance}` : "no steps";

  function pointText(p) {
    return hover([
      methods[p.m].name,
      fineness(p),
      `error ${short(p.error)} rad`,
      p.cpu && `processor ${short(p.cpu[1])} s (${short(p.cpu[0])} to ${short(p.cpu[2])})`,
      p.ns !== undefined && `${short(p.ns)} ns a step`,
      p.stepping && `${p.stepping} stepping`,
    ]);
  }

  function byMethod(points) {
    const present = [...new Set(points.map(p => p.m))];
    return present.map(m => [m, points.filter(p => p.m === m)]);
  }

  const plots = {
    speed(data, shown) {
      const faults = data.faults.filter(shown);
      const traces = byMethod(data.points.filter(p => p.cpu && shown(p))).map(([m, own]) => ({
        ...look(m),
        mode: "lines+markers",
        x: own.map(p => p.cpu[1]),
        y: own.map(p => logarithmic(p.error)),
        error_x: {
          type: "data", symmetric: false, thickness: 1, width: 2,
          array: own.map(p => p.cpu[2] - p.cpu[1]), arrayminus: own.map(p => p.cpu[1] - p.cpu[0]),
        },
        text: own.map(pointText),
      }));
      return [
        [...traces, ...besideMarks(faults)],
        layout({
          xaxis: axis("processor time, s", { type: "log", ...beside(faults) }),
          yaxis: axis(errorTitle, { type: "log" }),
          ...sideStrip(faults),
          ...withFloor(data.floor),
        }),
      ];
    },

    error(data, shown) {
      const faults = data.faults.filter(fault => fault.dt !== null && shown(fault));
      const steps = [...data.points, ...data.faults].map(p => p.dt).filter(dt => dt !== null);
      const plotted = data.points.filter(p => p.tolerance === null && shown(p)); // a tolerance is no step
      const traces = byMethod(plotted).map(([m, own]) => {
        const stepless = own[0].dt === null; // one error, drawn across all steps
        const points = stepless ? [Math.min(...steps), Math.max(...steps)].map(dt => ({ ...own[0], at: dt })) : own;
        return {
          ...look(m, data.ranks[m]),
          mode: "lines+markers",
          x: points.map(p => p.at ?? p.dt),
          y: points.map(p => logarithmic(p.error)),
          text: own.map(pointText).concat(stepless ? [pointText(own[0])] : []),
        };
      });
      const above = faults.length ? {
        yaxis2: { ...strip("not ok"), domain: [0.86, 1], anchor: "x" },
      } : {};
      const lane = lanes(faults);
      return [
        [...traces, ...marks(faults, fault => ({ x: [fault.dt], y: [lane(fault.m)], yaxis: "y2" }))],
        layout({
          xaxis: axis("step, s", { type: "log" }),
          yaxis: axis(errorTitle, { type: "log", domain: [0, faults.length ? 0.82 : 1] }),
          ...above,
          ...withFloor(data.floor),
        }),
      ];
    },

    drift(data, shown, choice) {
      const drift = data.drifts[choice];
      const missing = data.missing.filter(shown);
      const lines = Object.entries(drift ? drift.lines : {}).map(([m, values]) => [Number(m), values]);
      const traces = lines.filter(([m]) => shown({ m })).map(([m, values]) => {
        const line = unpacked(values, data.t.length);
        return {
          ...look(m, data.ranks[m]),
          mode: "lines+markers",
          marker: { ...look(m, data.ranks[m]).marker, maxdisplayed: 8 },
          x: data.t,
          y: line.map(logarithmic),
          text: line.map((value, k) => hover([methods[m].name, `${data.t[k]} s`, short(value)])),
        };
      });
      return [
        [...traces, ...besideMarks(missing)],
        layout({
          xaxis: axis("time, s", beside(missing)),
          yaxis: axis(`${drift ? drift.name : ""}; 0 at ${LEAST}`, { type: "log" }),
          ...sideStrip(missing),
        }),
      ];
    },
  };

  const parsed = new Map();
  function dataOf(section) {
    if (!parsed.has(section)) {
      parsed.set(section, JSON.parse(section.querySelector("script[type='application/json']").textContent));
    }
    return parsed.get(section);
  }

  function draw(section) {
    const data = dataOf(section);
    const boxes = [...section.querySelectorAll(".lines input")];
    const on = new Set(boxes.filter(box => box.checked).map(box => Number(box.value)));
    const choice = section.querySelector("select").selectedIndex;
    for (const plot of section.querySelectorAll(".plot")) {
      const [traces, layoutOf] = plots[plot.dataset.plot](data, thing => on.has(thing.m), choice);
      Plotly.react(plot, traces, layoutOf, config);
      plot.dataset.drawn = "";
    }
  }

  const sections = [...document.querySelectorAll(".scenario")];
  const drawn = new Set();
  function drawOnce(section) {
    if (drawn.has(section)) return;
    drawn.add(section);
    draw(section);
  }
  const observer = new IntersectionObserver(entries => {
    for (const entry of entries) if (entry.isIntersecting) drawOnce(entry.target.closest(".scenario"));
  }, { rootMargin: "400px" });
  for (const section of sections) observer.observe(section.querySelector(".plots"));

  for (const section of sections) {
    section.addEventListener("change", () => draw(section));
    section.addEventListener("click", event => {
      const { show } = event.target.dataset;
      if (show === undefined) return;
      for (const box of section.querySelectorAll(".lines input")) box.checked = show === "all";
      draw(section);
    });
  }

  const redraw = () => drawn.forEach(draw);
  dark.addEventListener("change", redraw);

  // The class gives plots the size and the colours of paper before they are measured for it.
  addEventListener("beforeprint", () => {
    root.classList.add("printing");
    sections.forEach(section => drawn.add(section));
    redraw();
  });
  addEventListener("afterprint", () => {
    root.classList.remove("printing");
    redraw();
  });

  document.addEventListener("click", async event => {
    const button = event.target.closest("[data-copy]");
    if (!button) return;
    const code = button.parentElement.querySelector("code");
    try {
      await navigator.clipboard.writeText(code.textContent);
      button.textContent = "copied";
    } catch {
      getSelection().selectAllChildren(code); // no access to the clipboard: left to the user's keys
    }
  });
})();
