// A link to a cell opens its part; a button copies the command next to it.
function openTarget() {
  const target = document.getElementById(location.hash.slice(1));
  if (target?.matches("details")) {
    target.open = true;
    target.scrollIntoView();
    target.querySelector("summary").focus({ preventScroll: true });
  }
}
addEventListener("hashchange", openTarget);
openTarget();

document.addEventListener("click", async event => {
  const link = event.target.closest("a[href^='#']");
  if (link && link.hash === location.hash) openTarget(); // the same cell again: the hash does not change
  const button = event.target.closest("[data-copy]");
  if (!button) return;
  const code = button.parentElement.querySelector("code");
  try {
    await navigator.clipboard.writeText(code.textContent);
    button.textContent = "copied";
  } catch {
    getSelection().selectAllChildren(code); // without clipboard access the user copies the selection
  }
});
