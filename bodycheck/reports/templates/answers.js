// The slider of the error: the table of settings, and the tints and texts of the heat map.
const answers = JSON.parse(document.getElementById("answers-data").textContent);
const slider = document.getElementById("error");
const scope = document.getElementById("scope");
const tolerance = () => answers.tolerances[slider.value];

const headings = [...document.querySelectorAll(".answers thead th")].map(head => head.textContent);

function cellOf(text, column) { // on a phone the headings stand in the rows
  const cell = document.createElement("td");
  cell.textContent = text;
  cell.dataset.heading = headings[column];
  return cell;
}

function answerRow(row) {
  const line = document.createElement("tr");
  const engine = line.appendChild(document.createElement("th"));
  engine.scope = "row";
  engine.textContent = row.engine;
  if (row.missed !== undefined) {
    line.className = "missed";
    const cell = line.appendChild(cellOf(`not met: ${row.missed}`, 0));
    cell.dataset.heading = "";
    cell.colSpan = 6;
    return line;
  }
  line.append(...[row.method, row.setting, "", row.speed ?? "not measured", row.limiting].map((text, k) => cellOf(text, k + 1)));
  const error = line.cells[3].appendChild(document.createElement("span"));
  error.className = "tag tint-good";
  error.textContent = row.error;
  const cell = line.appendChild(cellOf("", 6));
  for (const text of [row.snippet, row.reproduce].filter(Boolean)) {
    const code = cell.appendChild(document.createElement("div")).appendChild(document.createElement("code"));
    text.split(" ").forEach((word, k) => { // breaks at spaces only
      code.append(k ? " " : "", Object.assign(document.createElement("span"), { className: "whole", textContent: word }));
    });
    code.title = text;
    addCopyButton(code);
  }
  return line;
}

function showAnswers() {
  const text = `${short(tolerance())} rad`;
  for (const place of document.querySelectorAll("#tolerance, output.tolerance")) place.textContent = text;
  slider.setAttribute("aria-valuetext", text);
  document.querySelector(".answers tbody").replaceChildren(...answers.places[scope.selectedIndex][slider.value].map(k => answerRow(answers.rows[k])));
}

// The heat map: green meets the slider's error; a verdict of wrong or failed stays whatever is chosen.
const heat = document.getElementById("heat");
const heatData = JSON.parse(document.getElementById("map-data").textContent);
const shows = document.getElementById("map-shows");
const atStep = document.getElementById("map-step");
const withReference = document.getElementById("map-reference");
const heatRows = [...heat.tBodies[0].rows].map(row => [...row.cells].slice(1));
const columns = heatRows[0]?.length ?? 0;
const groups = [...heat.querySelectorAll("th[data-every]")];
const fewer = groups.map(group => group.colSpan);
const verdicts = new Map(heatRows.flat().map(cell => [cell, cell.firstElementChild?.innerHTML]));

const allSteps = new Set(heatData.cells.flatMap(cell => Object.keys(cell?.errors ?? {})));
for (const dt of [...allSteps].sort((a, b) => b - a)) atStep.add(new Option(`${dt} s`, dt));

const looksOf = {
  order: cell => ({ met: cell.met[slider.value] !== null, text: null }),
  error(cell, row) {
    const error = cell.errors[atStep.value || heatData.rows[row]];
    return error === undefined ? { met: null, text: "" } : { met: error <= tolerance(), text: short(error, 2) };
  },
  cost(cell) {
    const speed = cell.met[slider.value];
    return speed === null ? { met: false, text: "not met" } : { met: true, text: speed ? `${short(Number(speed.toPrecision(2)), 6)}×` : "met" };
  },
};

function showMap() {
  const look = looksOf[shows.value];
  atStep.parentElement.hidden = shows.value !== "error";
  heat.classList.toggle("collapsed", !withReference.checked);
  for (const [k, group] of groups.entries()) group.colSpan = withReference.checked ? group.dataset.every : fewer[k];
  heatRows.forEach((cells, row) => cells.forEach((td, column) => {
    const cell = heatData.cells[row * columns + column];
    if (!cell) return;
    const { met, text } = look(cell, row);
    const stays = ["bad", "fault", "none"].includes(cell.tint);
    const tint = stays ? cell.tint : met === null ? "none" : met ? "good" : "open";
    td.className = `tint-${tint}${td.classList.contains("of-reference") ? " of-reference" : ""}`;
    const link = td.firstElementChild;
    if (text === null) {
      link.innerHTML = verdicts.get(td);
      if (tint === "open" && ["good", "floor"].includes(cell.tint)) { // a tick would contradict the colour
        link.firstElementChild.textContent = "–";
        link.children[1].textContent += ", but not to the tolerance";
      }
    }
    else link.textContent = text || "not run";
  }));
  const seen = new Set([...heat.querySelectorAll("td [aria-hidden]")].filter(one => one.offsetParent).map(one => one.textContent));
  for (const mark of document.querySelectorAll("#map .marks li")) mark.hidden = !seen.has(mark.firstElementChild.textContent);
}

const start = String(answers.tolerances[slider.defaultValue]);
const storedError = answers.tolerances.findIndex(error => String(error) === String(Number(state.get("error"))));
if (storedError >= 0) slider.value = storedError;
for (const [control, key] of [[scope, "scope"], [shows, "map"], [atStep, "step"], [withReference, "reference"]]) {
  keepInAddress(control, key);
  control.addEventListener("change", () => {
    showAnswers();
    showMap();
  });
}
slider.addEventListener("input", () => {
  showAnswers();
  showMap();
});
slider.addEventListener("change", () => state.set("error", String(tolerance()) === start ? null : short(tolerance())));
showAnswers();
showMap();
