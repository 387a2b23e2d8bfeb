// Shared by all scripts of the page: methods, colours, data.
const root = document.documentElement;
const methods = JSON.parse(document.getElementById("methods-data").textContent);
const colour = name => getComputedStyle(root).getPropertyValue(name).trim();
const engineColour = m => colour(`--engine-${methods[m].colour}`);

// The same notation as in the tables: 0.0123, 1.23e-5.
function short(value, digits = 4) {
  const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
  if (value !== 0 && (exponent < -4 || exponent >= digits)) return `${Number(mantissa)}e${Number(exponent)}`;
  return String(Number(value.toPrecision(digits)));
}

// Lines for a logarithmic axis are stored as base64 of little-endian uint16: 2500 (18 + log10 value), or 0.
function lineValues(text) {
  const bytes = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  return Array.from({ length: bytes.length / 2 }, (_, k) => view.getUint16(2 * k, true))
    .map(code => (code ? 10 ** (code / 2500 - 18) : 0));
}

const parsed = new WeakMap();
function dataOf(element) {
  if (!parsed.has(element)) {
    parsed.set(element, JSON.parse(element.querySelector(":scope > script[type='application/json']").textContent));
  }
  return parsed.get(element);
}

// Before plots are measured for printing, every scenario is open, in the size and the colours of paper.
const scenarios = [...document.querySelectorAll("section.scenario > details")];
let closed = [];
addEventListener("beforeprint", () => {
  root.classList.add("printing");
  closed = scenarios.filter(part => !part.open);
  for (const part of closed) part.open = true;
});
addEventListener("afterprint", () => {
  root.classList.remove("printing");
  for (const part of closed) part.open = false;
});

const whenIdle = window.requestIdleCallback ?? window.setTimeout;

// Calls back once: before the element comes into view or is printed, or when nothing else is left to do.
function whenSeen(element, call) {
  let waits = true;
  const start = () => {
    if (!waits) return;
    waits = false;
    observer.disconnect();
    call();
  };
  const observer = new IntersectionObserver(entries => {
    if (entries.some(entry => entry.isIntersecting)) start();
  }, { rootMargin: "400px" });
  observer.observe(element);
  addEventListener("beforeprint", start);
  whenIdle(() => { if (element.getClientRects().length) start(); }); // of what is folded, only once it is opened
}

function addCopyButton(code) {
  const button = document.createElement("button");
  button.type = "button";
  button.dataset.copy = "";
  button.textContent = "copy";
  code.before(button, " ");
}
