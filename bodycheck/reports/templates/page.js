// Shared by all scripts of the page: methods, colours, data.
const root = document.documentElement;
const methods = JSON.parse(document.getElementById("methods-data").textContent);
const colour = name => getComputedStyle(root).getPropertyValue(name).trim();
const engineColour = m => colour(`--engine-${methods[m].colour}`);
const short = (value, digits = 4) => String(Number(value.toPrecision(digits)));

// Numbers are stored as base64 of little-endian float32.
function floats(text) {
  const bytes = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  return Array.from({ length: bytes.length / 4 }, (_, k) => view.getFloat32(4 * k, true));
}

const parsed = new WeakMap();
function dataOf(element) {
  if (!parsed.has(element)) {
    parsed.set(element, JSON.parse(element.querySelector(":scope > script[type='application/json']").textContent));
  }
  return parsed.get(element);
}

// The class sets the size and the colours of paper before plots are measured for printing.
addEventListener("beforeprint", () => root.classList.add("printing"));
addEventListener("afterprint", () => root.classList.remove("printing"));

// Calls back once, before the element comes into view or is printed.
function whenSeen(element, call) {
  const start = () => {
    observer.disconnect();
    removeEventListener("beforeprint", start);
    call();
  };
  const observer = new IntersectionObserver(entries => {
    if (entries.some(entry => entry.isIntersecting)) start();
  }, { rootMargin: "400px" });
  observer.observe(element);
  addEventListener("beforeprint", start);
}
