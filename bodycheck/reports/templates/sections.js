// Draws the plots of a section when it comes into view, and again when a choice changes.
const dark = matchMedia("(prefers-color-scheme: dark)");

function choicesOf(section) {
  const selects = [...section.querySelectorAll("select[data-choice]")];
  return Object.fromEntries(selects.map(select => [select.dataset.choice, select.selectedIndex]));
}

function draw(section) {
  const data = dataOf(section);
  const boxes = [...section.querySelectorAll(".lines input")];
  const on = new Set(boxes.filter(box => box.checked).map(box => Number(box.value)));
  const chosen = choicesOf(section);
  for (const plot of section.querySelectorAll(".plot")) {
    const [traces, layoutOf] = plots[plot.dataset.plot](data, thing => on.has(thing.m), chosen);
    Plotly.react(plot, traces, layoutOf, config);
    plot.dataset.drawn = "";
  }
}

// Of the tables with one instance per error, show only the chosen one.
function showChosen(section) {
  const select = section.querySelector("select[data-choice=error]");
  for (const part of select ? section.querySelectorAll("[data-error]") : []) {
    part.hidden = part.dataset.error !== select.value;
  }
}

const narrow = matchMedia("(max-width: 40rem)").matches;
const legends = [...document.querySelectorAll("details.lines")];
for (const legend of legends) legend.open = !narrow;

const sections = [...document.querySelectorAll("[data-section]")].filter(section => section.querySelector(".plots"));
const drawn = new Set();
for (const section of sections) {
  showChosen(section);
  whenSeen(section.querySelector(".plots"), () => {
    drawn.add(section);
    draw(section);
  });
  section.addEventListener("change", () => {
    showChosen(section);
    draw(section);
  });
  section.addEventListener("click", event => {
    const { show } = event.target.dataset;
    if (show === undefined) return;
    for (const box of section.querySelectorAll(".lines input")) box.checked = show === "all";
    draw(section);
  });
}

const redraw = () => drawn.forEach(draw);
dark.addEventListener("change", redraw);
addEventListener("afterprint", redraw);
addEventListener("beforeprint", () => {
  for (const legend of legends) legend.open = true;
  redraw();
});
