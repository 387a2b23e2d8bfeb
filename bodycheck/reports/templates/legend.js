// One legend for the whole page: selected lines are drawn in colour, the others thin and grey, or not at all.
const legend = document.getElementById("lines");
const boxes = [...legend.querySelectorAll("input[value]:not([data-engine])")];
const chips = [...legend.querySelectorAll("input[data-engine]")];
const others = document.getElementById("others");
const measure = document.getElementById("measure");
const selected = new Set();

const levelOf = m => (selected.has(Number(m)) ? "on" : others.checked ? "grey" : null);
const numbersOf = engine => methods.filter(style => style.engine === engine).map(style => style.number);
const initial = new Set(boxes.filter(box => box.defaultChecked).map(box => Number(box.value)));

// The selection as text: an engine all of whose methods are selected, or else each of them.
const selectionText = () => chips.flatMap(({ dataset: { engine } }) => {
  const own = numbersOf(engine);
  return own.every(m => selected.has(m)) ? [engine] : own.filter(m => selected.has(m)).map(m => methods[m].name);
}).join(",");

function select(numbers) {
  selected.clear();
  for (const m of numbers) selected.add(m);
  for (const box of boxes) box.checked = selected.has(Number(box.value));
  for (const chip of chips) {
    const own = numbersOf(chip.dataset.engine);
    const on = own.filter(m => selected.has(m)).length;
    chip.checked = on === own.length;
    chip.indeterminate = on > 0 && on < own.length;
  }
}

function choose(numbers) {
  select(numbers);
  const isInitial = selected.size === initial.size && [...initial].every(m => selected.has(m));
  state.set("lines", isInitial ? null : selectionText());
  redraw();
}

const stored = state.get("lines")?.split(",");
select(stored ? methods.filter(style => stored.includes(style.engine) || stored.includes(style.name)).map(style => style.number) : initial);
keepInAddress(others, "others");
keepInAddress(measure, "measure");

for (const box of boxes) {
  box.addEventListener("change", () => {
    const m = Number(box.value);
    choose(box.checked ? [...selected, m] : [...selected].filter(own => own !== m));
  });
}
for (const chip of chips) {
  chip.addEventListener("change", () => {
    const own = numbersOf(chip.dataset.engine);
    const rest = [...selected].filter(m => !own.includes(m));
    choose(chip.checked ? [...rest, ...own] : rest);
  });
}
legend.addEventListener("click", event => {
  const { only, order } = event.target.dataset;
  if (only !== undefined) choose(numbersOf(only));
  if (order !== undefined) choose(boxes.filter(box => box.dataset.firstOrder !== undefined).map(box => Number(box.value)));
});
others.addEventListener("change", () => redraw());
measure.addEventListener("change", () => {
  showChosen();
  redraw();
});
