// Cells of tables get the head of their column, and long names break at _ and /; a table that is still wider
// than the page is stacked (site.css).
for (const table of document.querySelectorAll("article table.docutils")) {
  const heads = [...table.querySelectorAll("thead th")].map((head) => head.innerText.trim());
  for (const cell of table.querySelectorAll("tbody td")) {
    const head = heads[cell.cellIndex];
    if (head && cell.cellIndex && cell.innerText.trim()) cell.dataset.head = `${head}:`;
    if (!/\S{25}/.test(cell.textContent)) continue;
    cell.classList.add("long");
    for (const part of cell.querySelectorAll("p, span.pre")) {
      if (!part.children.length) part.innerHTML = part.innerHTML.replace(/[_/](?=\S)/g, "$&<wbr>");
    }
  }
  const around = table.closest(".table-wrapper") ?? table.parentElement;
  const fit = () => {
    table.classList.remove("stacked");
    table.classList.toggle("stacked", around.scrollWidth > around.clientWidth + 1);
  };
  fit();
  addEventListener("resize", fit);
}

// Pictures lead to themselves in full size.
for (const picture of document.querySelectorAll("article img")) {
  if (picture.closest("a")) continue;
  const link = document.createElement("a");
  link.href = picture.src;
  picture.replaceWith(link);
  link.append(picture);
}
