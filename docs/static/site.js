// Cells of tables get the head of their column; a table that is wider than the page is stacked (site.css).
for (const table of document.querySelectorAll("article table.docutils")) {
  const heads = [...table.querySelectorAll("thead th")].map((head) => head.innerText.trim());
  for (const cell of table.querySelectorAll("tbody td")) {
    const head = heads[cell.cellIndex];
    if (head && cell.cellIndex) cell.dataset.head = `${head}:`;
    if (/\S{25}/.test(cell.textContent)) cell.classList.add("long");
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
