// The state of the page in its address: #ANCHOR?error=1e-6&lines=mujoco,dart. A link with it opens the same view.
const state = {
  read() {
    const [anchor, query = ""] = location.hash.slice(1).split("?");
    return { anchor, values: new URLSearchParams(query) };
  },
  get: key => state.read().values.get(key),
  set(key, value) { // null is the default, which the address does not name
    const { anchor, values } = state.read();
    if (value === null) values.delete(key);
    else values.set(key, value);
    const query = values.toString();
    history.replaceState(null, "", `#${anchor}${query && `?${query}`}`);
  },
};

// Keeps a select or a checkbox in the address; its markup is the default.
function keepInAddress(control, key) {
  const box = control.type === "checkbox";
  const read = () => (box ? String(Number(control.checked)) : control.value);
  const initial = read();
  const stored = state.get(key);
  if (stored !== null && box) control.checked = stored === "1";
  if (stored !== null && !box && [...control.options].some(option => option.value === stored)) control.value = stored;
  control.addEventListener("change", () => state.set(key, read() === initial ? null : read()));
}
