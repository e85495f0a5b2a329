for (const table of document.querySelectorAll("table.entries")) {
  const make = (tag, properties, ...children) => {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...children);
    return made;
  };
  const rows = [...table.tBodies[0].rows], has = (row, tag) => row.dataset.tags.split(",").includes(tag);
  const tags = [...new Set(rows.flatMap(row => row.dataset.tags.split(",")))].filter(tag => tag && !rows.every(row => has(row, tag)));
  const search = make("input", { type: "search", placeholder: "Filter entries", ariaLabel: "Filter entries", oninput: filter });
  const boxes = tags.map(value => make("input", { type: "checkbox", value, onchange: filter })), count = make("span", { ariaLive: "polite" });
  function filter() {
    const words = search.value.toLowerCase().split(/\s+/), wanted = boxes.filter(box => box.checked);
    for (const row of rows) {
      const text = row.textContent.toLowerCase();
      row.hidden = !words.every(word => text.includes(word)) || !wanted.every(box => has(row, box.value));
    }
    count.textContent = `${rows.filter(row => !row.hidden).length} of ${rows.length}`;
  }
  const cells = row => [...row.cells].map(cell => cell.dataset.v || cell.innerText.replace(/\s+/g, " ").trim());
  const quoted = text => `"${text.replaceAll('"', '""')}"`;
  const csv = make("a", { download: `${document.title}.csv`, href: "#", onclick: () => {
    const lines = [table.tHead.rows[0], ...[...table.tBodies[0].rows].filter(row => !row.hidden)].map(row => cells(row).map(quoted).join(","));
    csv.href = `data:text/csv;charset=utf-8,${encodeURIComponent(lines.join("\n") + "\n")}`;
  } }, "CSV");
  const labels = boxes.map(box => make("label", {}, box, ` ${box.value}`));
  table.closest(".scroll").before(make("div", { className: "filters" }, search, ...labels, count, csv));
  filter();
}
for (const table of document.querySelectorAll("table[data-sortable]")) {
  const body = table.tBodies[0];
  for (const head of table.querySelectorAll("th[data-sort]")) {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    const arrow = document.createElement("span");
    arrow.className = "arrow";
    button.insertBefore(arrow, button.querySelector(".sub"));
    head.append(button);
    const column = head.cellIndex;
    button.addEventListener("click", () => {
      const before = head.getAttribute("aria-sort");
      const down = before ? before === "ascending" : "down" in head.dataset;
      for (const each of table.querySelectorAll("th[aria-sort]")) each.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      table.classList.toggle("sorted", column > 0 || down || body.parentNode.classList.contains("others"));
      const value = row => row.cells[column].dataset.v;
      const compare = (a, b) => {
        if (a === "" || b === "") return (a === "") - (b === "");
        const order = isNaN(a) || isNaN(b) ? a.localeCompare(b) : a - b;
        return down ? -order : order;
      };
      body.append(...[...body.rows].sort((a, b) => compare(value(a), value(b))));
    });
  }
}
