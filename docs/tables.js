"use strict";
// Tables that can be sorted, filtered and downloaded: each table.sheet of a page, and the tables of studies, which are in
// tables/*.js, on the page that has #data. A cell is its text, or its data-v where that is another one.

const MOST = 7; // columns of a table of a study that are shown at first
const loaded = {};
function addTables(study, tables) { loaded[study] = tables; }

const element = (name, attributes = {}, ...children) => {
  const made = Object.assign(document.createElement(name), attributes);
  made.append(...children);
  return made;
};

// The number that a cell starts with, or null: 12.5 % (9.0 to 14.1), below 2, +0.57.
function leading(cell) {
  const found = /^(?:below |above )?([-+]?\d[\d,]*(?:\.\d+)?(?:e-?\d+)?)/.exec(cell);
  return found ? Number(found[1].replaceAll(",", "")) : null;
}

function csv(rows) {
  const quoted = (cell) => (/[",\n]/.test(cell) ? `"${cell.replaceAll('"', '""')}"` : cell);
  return rows.map((row) => row.map(quoted).join(",")).join("\n") + "\n";
}

const text = (cell) => cell.dataset.v ?? cell.textContent.replace(/\s+/g, " ").trim();

// Sort by a column; what is no number comes last, in both directions.
function sort(table, head) {
  const body = table.tBodies[0], column = head.cellIndex, rows = [...body.rows].map((row) => [row, text(row.cells[column])]);
  const before = head.ariaSort, hasNumbers = rows.some(([, cell]) => leading(cell) !== null);
  const isFalling = before ? before === "ascending" : hasNumbers && !("up" in head.dataset);
  for (const each of table.tHead.rows[0].cells) each.ariaSort = null;
  head.ariaSort = isFalling ? "descending" : "ascending";
  table.classList.add("sorted");
  const compare = ([, a], [, b]) => {
    const [x, y] = [leading(a), leading(b)], sign = isFalling ? -1 : 1;
    if (x !== null && y !== null) return sign * (x - y);
    return x !== null || y !== null ? (x === null) - (y === null) : sign * a.localeCompare(b);
  };
  body.append(...rows.sort(compare).map(([row]) => row));
}

// Make a table answer. Where it has data-tags, as "learned planning;real-time", as its rows have, there is a box for each
// tag that some rows have; a row is shown that has one of the chosen tags of each group. Columns from the
// number `shown` on are hidden until the reader chooses them.
function equip(table, name, shown = Infinity) {
  const heads = [...table.tHead.rows[0].cells], rows = [...table.tBodies[0].rows];
  const hidden = new Set([...heads.keys()].filter((i) => i >= shown));
  const tagsOf = (row) => (row.dataset.tags ?? "").split(";").map((group) => group.split(" ").filter(Boolean));
  const filter = element("input", { type: "search", placeholder: "Filter rows", ariaLabel: "Filter rows" });
  const count = element("span", { className: "count", ariaLive: "polite" });
  const download = element("a", { className: "md-button", download: `${name}.csv`, textContent: "Download CSV" });
  const chooser = element("details", { className: "columns" }, element("summary", { textContent: hidden.size ? `${hidden.size} more columns` : "Columns" }));
  const groups = tagsOf(table).map((tags, group) => {
    const share = (tag) => rows.filter((row) => tagsOf(row)[group].includes(tag)).length / rows.length;
    return tags.filter((tag) => share(tag) % 1).map((value) => element("input", { type: "checkbox", value, onchange: draw }));
  });
  const labelled = (box, words) => element("label", {}, box, ` ${words}`);

  function draw() {
    const words = filter.value.toLowerCase().split(/\s+/);
    const wanted = groups.map((boxes) => boxes.filter((box) => box.checked).map((box) => box.value));
    for (const row of rows) {
      const said = row.textContent.toLowerCase(), tags = tagsOf(row);
      const isWanted = wanted.every((group, i) => !group.length || group.some((tag) => tags[i].includes(tag)));
      row.hidden = !isWanted || !words.every((word) => said.includes(word));
    }
    for (const row of table.rows) for (const cell of row.cells) cell.hidden = hidden.has(cell.cellIndex);
    count.textContent = `${rows.filter((row) => !row.hidden).length} of ${rows.length} rows`;
  }
  heads.forEach((head, i) => {
    const box = element("input", { type: "checkbox", checked: !hidden.has(i) });
    box.onchange = () => { hidden[box.checked ? "delete" : "add"](i); draw(); };
    chooser.append(labelled(box, text(head) || "(first)"));
    head.append(element("button", { type: "button", onclick: () => sort(table, head) }, ...head.childNodes));
  });
  download.onclick = () => {
    const shown = [...table.rows].filter((row) => !row.hidden).map((row) => [...row.cells].filter((cell) => !cell.hidden).map(text));
    download.href = `data:text/csv;charset=utf-8,${encodeURIComponent(csv(shown))}`;
  };
  filter.oninput = draw;
  download.href = "#";
  const boxes = groups.flat().map((box) => labelled(box, box.value));
  const place = table.parentNode.matches(".scroll") ? table.parentNode : table;
  place.before(element("div", { className: "bar" }, filter, ...boxes, count, download, chooser));
  draw();
}

// A success rate shades its cell, from 0 to 100 %.
function shade(cell, heading, title) {
  const rate = /^([\d.]+) ?%/.exec(cell.textContent);
  if (!rate || !/success/.test(`${heading} ${title}`) || /collision|fault|time-out/.test(heading)) return;
  cell.style.setProperty("--rate", `${rate[1]}%`);
  cell.className = "rate";
}

function showTable(place, { title, header, rows }, name) {
  const body = rows.map((row) => element("tr", {}, ...header.map((heading, i) => {
    const cell = element("td", { textContent: row[i] ?? "" });
    shade(cell, heading, `${title} ${header[0]}`);
    return cell;
  })));
  const heads = header.map((textContent) => element("th", { scope: "col", textContent }));
  const table = element("table", { className: "sheet" }, element("thead", {}, element("tr", {}, ...heads)), element("tbody", {}, ...body));
  place.replaceChildren(element("div", { className: "scroll", tabIndex: 0 }, table));
  equip(table, name, MOST);
}

function start(root) {
  const studies = element("select", { ariaLabel: "Study" }, ...Object.keys(STUDIES).map((name) => new Option(name)));
  const tables = element("select", { ariaLabel: "Table" });
  const place = element("div");
  root.replaceChildren(element("div", { className: "bar" }, studies, tables), place);

  function load(study, wanted) {
    studies.value = study;
    tables.replaceChildren(...STUDIES[study].map((title, i) => new Option(title, i)));
    const show = () => {
      const index = STUDIES[study][wanted] === undefined ? 0 : wanted;
      tables.value = index;
      history.replaceState(null, "", `#${study}${index ? `/${index}` : ""}`);
      showTable(place, loaded[study][index], `${study}-${index}`);
    };
    if (loaded[study]) return show();
    document.head.append(element("script", { src: `tables/${study}.js`, onload: show }));
  }
  function read() {
    const [study, index] = decodeURIComponent(location.hash.slice(1)).split("/");
    load(STUDIES[study] ? study : "suite" in STUDIES ? "suite" : Object.keys(STUDIES)[0], Number(index || 0));
  }
  studies.onchange = () => load(studies.value, 0);
  tables.onchange = () => load(studies.value, Number(tables.value));
  window.addEventListener("hashchange", read);
  read();
}

for (const table of document.querySelectorAll("table.sheet")) equip(table, document.title);
if (document.getElementById("data")) start(document.getElementById("data"));
