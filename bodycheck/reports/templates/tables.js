// A click on a heading sorts its table: numbers by size, words by letter, empty cells last.
function sortKey(cell) {
  const text = cell.textContent.trim();
  const value = Number(text.replace(/^≥ /, ""));
  return text === "" ? null : Number.isNaN(value) ? text : value;
}

function compared(a, b) {
  if (a === null || b === null) return (a === null) - (b === null);
  return typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b));
}

for (const head of document.querySelectorAll("table.sortable > thead th")) {
  const button = document.createElement("button");
  button.type = "button";
  button.className = "sort";
  button.append(...head.childNodes);
  head.append(button);
}

document.addEventListener("click", event => {
  const head = event.target.closest("table.sortable > thead th");
  if (!head) return;
  const table = head.closest("table");
  const sign = head.getAttribute("aria-sort") === "ascending" ? -1 : 1;
  for (const other of head.parentElement.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
  const place = head.cellIndex;
  const rows = [...table.tBodies[0].rows].map(row => [sortKey(row.cells[place]), row]);
  rows.sort(([a], [b]) => (a === null || b === null ? compared(a, b) : sign * compared(a, b)));
  table.tBodies[0].append(...rows.map(([, row]) => row));
});

// The reference's own methods in the tables of a scenario, on request.
for (const table of document.querySelectorAll("table.standing")) {
  const own = table.querySelectorAll(".of-reference").length;
  if (!own || own === table.tBodies[0].rows.length) {
    table.classList.remove("collapsed");
    continue;
  }
  const button = document.createElement("button");
  button.type = "button";
  const tell = () => { button.textContent = `${table.classList.contains("collapsed") ? "show" : "hide"} the reference’s ${own} own methods`; };
  button.addEventListener("click", () => {
    table.classList.toggle("collapsed");
    tell();
  });
  tell();
  table.parentElement.after(button);
}
