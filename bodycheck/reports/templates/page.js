// What all scripts of the page share: its methods, its colours, its data.
const root = document.documentElement;
const methods = JSON.parse(document.getElementById("methods-data").textContent);
const colour = name => getComputedStyle(root).getPropertyValue(name).trim();
const engineColour = m => colour(`--engine-${methods[m].colour}`);
const short = (value, digits = 4) => String(Number(value.toPrecision(digits)));

// Numbers come as the base64 of their float32 values, low byte first.
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

// The class gives what is drawn the size and the colours of paper before it is measured for it.
addEventListener("beforeprint", () => root.classList.add("printing"));
addEventListener("afterprint", () => root.classList.remove("printing"));

// Calls once, when the element is about to come into view or to be printed.
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
