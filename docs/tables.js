"use strict";
// The page of tables: choose a study and a table, sort, filter, choose columns, download. Tables are in tables/*.js.

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

function order(a, b) {
  const [x, y] = [leading(a), leading(b)];
  if (x !== null && y !== null) return x - y;
  if (x !== null || y !== null) return x === null ? 1 : -1;
  return a.localeCompare(b);
}

function csv(rows) {
  const quoted = (cell) => (/[",\n]/.test(cell) ? `"${cell.replaceAll('"', '""')}"` : cell);
  return rows.map((row) => row.map(quoted).join(",")).join("\n") + "\n";
}

// A success rate shades its cell, from 0 to 100 %.
function shade(cell, heading, title) {
  const rate = /^([\d.]+) ?%/.exec(cell);
  if (!rate || !/success/.test(`${heading} ${title}`) || /collision|fault|time-out/.test(heading)) return "";
  return `--rate: ${rate[1]}%`;
}

function showTable(place, table, name) {
  let sorted = null, falling = true;
  const hidden = new Set();
  const filter = element("input", { type: "search", placeholder: "Filter rows", ariaLabel: "Filter rows" });
  const count = element("span", { className: "count", ariaLive: "polite" });
  const download = element("a", { className: "md-button", download: `${name}.csv`, textContent: "Download CSV" });
  const chooser = element("details", { className: "columns" }, element("summary", { textContent: "Columns" }));
  const body = element("tbody");
  const heads = element("tr");
  const grid = element("table", { className: "sheet" }, element("thead", {}, heads), body);

  const shown = () => table.header.map((_, i) => i).filter((i) => !hidden.has(i));
  function rows() {
    const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    const kept = table.rows.filter((row) => words.every((word) => row.join(" ").toLowerCase().includes(word)));
    if (sorted !== null) kept.sort((a, b) => {
      const [x, y] = [a[sorted] ?? "", b[sorted] ?? ""];
      const missing = (leading(x) === null) - (leading(y) === null);
      return missing || order(x, y) * (falling ? -1 : 1);
    });
    return kept;
  }
  function draw() {
    const kept = rows(), columns = shown();
    heads.replaceChildren(...columns.map((i) => {
      const arrow = sorted === i ? (falling ? " ▾" : " ▴") : "";
      const button = element("button", { type: "button", textContent: table.header[i] + arrow });
      button.onclick = () => {
        falling = sorted === i ? !falling : table.rows.some((row) => leading(row[i] ?? "") !== null);
        sorted = i;
        draw();
        heads.querySelectorAll("button")[columns.indexOf(i)].focus();
      };
      return element("th", { scope: "col", ariaSort: sorted === i ? (falling ? "descending" : "ascending") : "none" }, button);
    }));
    body.replaceChildren(...kept.map((row) => element("tr", {}, ...columns.map((i) => {
      const cell = element("td", { textContent: row[i] ?? "" });
      const style = shade(cell.textContent, table.header[i], `${table.title} ${table.header[0]}`);
      if (style) { cell.style.cssText = style; cell.className = "rate"; }
      return cell;
    }))));
    count.textContent = `${kept.length} of ${table.rows.length} rows`;
    const data = csv([columns.map((i) => table.header[i]), ...kept.map((row) => columns.map((i) => row[i] ?? ""))]);
    download.href = `data:text/csv;charset=utf-8,${encodeURIComponent(data)}`;
  }
  table.header.forEach((heading, i) => {
    const box = element("input", { type: "checkbox", checked: true });
    box.onchange = () => { hidden[box.checked ? "delete" : "add"](i); draw(); };
    chooser.append(element("label", {}, box, ` ${heading || "(first)"}`));
  });
  filter.oninput = draw;
  place.replaceChildren(element("div", { className: "bar" }, filter, count, download), chooser,
    element("div", { className: "scroll", tabIndex: 0 }, grid));
  draw();
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

start(document.getElementById("data"));
