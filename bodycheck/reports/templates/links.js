const COPIED_MS = 2000; // for which a button of a link says so

// Every command gets a button that copies it.
for (const code of document.querySelectorAll(".cases td:last-child > code, p.command > code, .findings td > code")) addCopyButton(code);

// A link to a part opens it and what is around it; a button copies the command next to it.
function openTarget() {
  const { anchor } = state.read();
  const target = anchor && document.getElementById(anchor);
  if (!target) return;
  for (let part = target; part; part = part.parentElement) if (part.matches("details")) part.open = true;
  const inner = target.querySelector(":scope > details");
  if (inner && target.matches("section")) inner.open = true;
  target.scrollIntoView();
  for (const part of document.querySelectorAll(".linked")) part.classList.remove("linked");
  if (target.matches("figure")) target.classList.add("linked");
  target.querySelector("summary")?.focus({ preventScroll: true });
}
addEventListener("popstate", openTarget); // also of a hash that was typed
openTarget();

// Copies the address that opens the figure of a button; without clipboard access it is in the address bar.
async function copyLink(button) {
  const [, query] = location.hash.split("?");
  history.replaceState(null, "", `#${button.closest("figure").id}${query ? `?${query}` : ""}`);
  const text = button.textContent;
  try {
    await navigator.clipboard.writeText(location.href);
    button.textContent = "copied";
  } catch {
    button.textContent = "in the address bar";
  }
  setTimeout(() => { button.textContent = text; }, COPIED_MS);
}

// Another page of this report opens with the choices made on this one.
document.addEventListener("click", event => {
  const link = event.target.closest("a[href*='.html']");
  const [, query] = location.hash.split("?");
  if (!link || !query || link.protocol !== location.protocol || link.host !== location.host) return;
  link.hash = `${link.hash.split("?")[0] || "#"}?${query}`;
});

document.addEventListener("click", async event => {
  const link = event.target.closest("a[href^='#']");
  if (link && !event.ctrlKey && !event.metaKey && !event.shiftKey) { // a step in the history, with the state of the page in the new address
    event.preventDefault();
    const [, query = ""] = location.hash.split("?");
    history.pushState(null, "", link.hash + (query && `?${query}`));
    openTarget();
  }
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
