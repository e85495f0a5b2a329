// Plays recorded cases. Data are in data/, written by `crowdbench export --format replay`: see pages.py.
"use strict";

const replay = (() => {
  const MOST = 4; // planners side by side
  const BEFORE = 3; // seconds before its end at which a failure is shown
  const ENDS = { s: ["✓", "success"], c: ["✗", "collision"], w: ["✗", "hits an obstacle"], t: ["◷", "out of time"] };
  const DIGITS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";
  const $ = id => document.getElementById(id);
  const data = {}, waiting = {}, played = new Set(); // episodes that have been played to their end
  let index, colors, scenario, name, number, chosen = [], episodes = {}, obstacles = [];
  let box, time = 0, end = 0, playing = 0, before, areShown = false, dark = matchMedia("(prefers-color-scheme: dark)").matches;

  // Data, which are scripts, as a page of a file system can read nothing else.

  const take = (key, values) => { data[key] = values; };

  const load = key => waiting[key] ??= new Promise((done, fail) => {
    const script = document.createElement("script");
    script.src = `data/${key.split("/").map(encodeURIComponent).join("/")}.js`;
    script.onload = () => done(data[key]);
    script.onerror = () => fail(new Error(`${script.src} cannot be read`));
    document.head.append(script);
  });

  function reader(text) {
    let at = 0;
    const next = () => {
      let value = 0, shift = 1, digit;
      do {
        digit = DIGITS.indexOf(text[at++]);
        value += (digit & 31) * shift;
        shift *= 32;
      } while (digit > 31);
      return value % 2 ? (1 - value) / 2 : value / 2;
    };
    const many = count => Array.from({ length: count }, next);
    const sums = values => { let sum = 0; return values.map(value => sum += value); };
    const flag = count => { // true until it first turns
      const turns = sums(many(next()));
      return Array.from({ length: count }, (_, state) => turns.filter(turn => turn <= state).length % 2 === 0);
    };
    const lines = quantum => {
      let x = 0, y = 0;
      const point = () => [(x += next()) * quantum, (y += next()) * quantum];
      return many(next()).map(count => Array.from({ length: count }, point));
    };
    const path = (count, quantum) => sums(sums(many(count))).map(value => value * quantum);
    return { many, sums, flag, lines, path, isOver: () => at === text.length };
  }

  function decode(episode, paths) {
    const read = reader(episode.tracks), gap = reader(episode.gap), { quantum } = index, stays = [], planned = [];
    while (!read.isOver()) {
      const [agent, first, count, radius] = read.many(4), x = read.path(count, quantum), y = read.path(count, quantum);
      const seen = read.flag(count), noticed = episode.attention ? read.flag(count) : [];
      stays.push({ agent, first, last: first + count - 1, radius: radius * quantum, x, y, seen, noticed });
    }
    if (paths) {
      const ways = reader(paths), counts = ways.many(index.paths.length * (episode.steps + 1)), lines = ways.lines(index.coarse);
      while (counts.length) planned.push(Object.fromEntries(index.paths.map(kind => [kind, lines.splice(0, counts.shift())])));
    }
    const heading = reader(episode.heading).path(episode.steps + 1, 0.01);
    return { ...episode, stays, planned, heading, gap: gap.sums(gap.many(episode.steps)), end: episode.steps * scenario.dt };
  }

  // Which case is shown: #door_10/val/3/mppi,orca@6.25, or with a board before the scenario.

  const ending = (planner, which) => scenario.runs[planner].outcomes[scenario.runs[planner].names.indexOf(which)] ?? "";
  const keyOf = (planner, which) => `${name}/${which}/${planner}`;
  const isKnown = (planner, which) => areShown || played.has(keyOf(planner, which));
  const sign = (planner, which) => isKnown(planner, which) ? ENDS[ending(planner, which)]?.[0] ?? "" : "";
  const fails = which => chosen.some(planner => "cwt".includes(ending(planner, which) || "s"));
  const link = () => `#${name}/${number}/${chosen}${time ? `@${+time.toFixed(2)}` : ""}`;

  async function follow() {
    const match = decodeURI(location.hash).match(/^#(?:.*\/)?([^/]+)\/(\w+\/\d+)(?:\/([^@/]*))?(?:@([\d.]+))?$/) ?? [];
    await show(match[1], match[2], (match[3] ?? "").split(","), +match[4] || 0);
    if (!match[4] && !matchMedia("(prefers-reduced-motion: reduce)").matches) play(true);
  }

  async function show(which, wish, planners, start = 0) {
    if (!index.scenarios[which]) which = Object.keys(index.scenarios)[0];
    scenario = index.scenarios[which];
    const has = planner => scenario.runs[planner] && (!scenario.cases.includes(wish) || ending(planner, wish));
    const all = Object.keys(scenario.runs).filter(has), known = planners.filter(planner => all.includes(planner));
    chosen = known.length ? known.slice(0, MOST) : all.slice(0, 2);
    number = scenario.cases.includes(wish) ? wish : scenario.cases.find(fails) ?? scenario.cases[0];
    chosen = chosen.filter(planner => ending(planner, number));
    if (which !== name) fill(name = which);
    const key = `${name}/${number.replace("/", "-")}`, shown = chosen, these = await load(key);
    const isRecorded = chosen.some(planner => scenario.runs[planner].recorded.includes(+number.split("/")[1]));
    const paths = isRecorded ? await load(`${key}.paths`) : {};
    if (shown !== chosen) return; // something else was asked for meanwhile
    obstacles = reader(these[chosen[0]].obstacles).lines(index.quantum);
    episodes = Object.fromEntries(chosen.map(planner => [planner, decode(these[planner], paths[planner])]));
    end = Math.max(...chosen.map(planner => episodes[planner].end));
    time = Math.min(start, end);
    arrange();
  }

  // What is around the pictures.

  function element(tag, properties, ...children) {
    const made = Object.assign(document.createElement(tag), properties);
    made.append(...children);
    return made;
  }

  function fill() {
    $("scenario").value = name;
    $("about").textContent = scenario.description;
    $("case").replaceChildren(...scenario.cases.map(value => element("option", { value })));
  }

  function tell() { // outcomes, of episodes that have been played, or of all
    const planners = Object.keys(scenario.runs);
    for (const option of $("case").children) {
      const signs = planners.length > 8 ? "" : planners.map(planner => sign(planner, option.value)).join("");
      option.textContent = `${option.value} ${signs}`;
    }
    [...$("planners").children].forEach((button, k) => { button.textContent = `${planners[k]} ${sign(planners[k], number)}`; });
    for (const each of document.querySelectorAll("#verdicts > div, #ends > span")) each.classList.toggle("unknown", !isKnown(each.dataset.planner, number));
    $("outcomes").setAttribute("aria-pressed", areShown);
    overview();
  }

  function arrange() {
    document.title = `${name}, case ${number} · crowdbench replay`;
    history.replaceState(null, "", link());
    $("case").value = number;
    const focus = [...$("planners").children].indexOf(document.activeElement);
    $("planners").replaceChildren(...Object.entries(scenario.runs).map(([planner, { label }]) => {
      const others = chosen.filter(other => other !== planner);
      const wish = others.length < chosen.length ? others : [...others.slice(1 - MOST), planner];
      const onclick = () => { if (wish.length) show(name, number, wish, time); };
      const made = element("button", { title: label, disabled: !ending(planner, number), onclick });
      made.setAttribute("aria-pressed", chosen.includes(planner));
      return made;
    }));
    $("planners").children[focus]?.focus();
    $("panels").replaceChildren(...chosen.map(planner => {
      const canvas = element("canvas", { role: "img" }), caption = element("span", {});
      Object.assign(episodes[planner], { canvas, caption });
      return element("figure", {}, element("figcaption", {}, element("span", {}, ...planner.split(/(?<=_)/).flatMap(part => [part, element("wbr")])), caption), canvas);
    }));
    $("verdicts").replaceChildren(...chosen.map(planner => {
      const { verdict: [first, ...more], end: last, outcome } = episodes[planner];
      const onclick = () => { time = Math.max(0, last - BEFORE); play(true); };
      const details = element("details", { ontoggle: fit }, element("summary", {}, "Details"), ...more.map(text => element("p", {}, text)));
      const told = first ? [element("p", {}, `${planner}: ${first}`), details] : [element("p", {}, `${planner}: Success after ${+last.toFixed(2)} s.`)];
      const verdict = element("div", { className: `verdict ${outcome}` }, element("div", {}, ...told), ...first ? [element("button", { onclick }, `▶ Last ${BEFORE} s`)] : []);
      verdict.append(element("p", { className: "wait quiet" }, `${planner}: the verdict follows at the end.`));
      verdict.dataset.planner = planner;
      return verdict;
    }));
    $("ends").replaceChildren(...chosen.map(planner => {
      const { outcome, end: last } = episodes[planner], made = element("span", { className: outcome }, ENDS[outcome][0]);
      made.dataset.planner = planner;
      made.style.left = `${100 * last / end}%`;
      return made;
    }));
    Object.assign($("time"), { max: end, step: scenario.dt / 5 });
    explain();
    tell();
    fit();
  }

  function explain() {
    const all = Object.values(episodes), stays = all.flatMap(episode => episode.stays.slice(1)), boxes = [...$("marks").querySelectorAll("input")];
    const sample = kind => {
      const canvas = element("canvas", { width: 44, height: 36 }), pen = canvas.getContext("2d");
      pen.scale(2, 2);
      if (kind === "measured") line(pen, Array.from({ length: 25 }, (_, k) => [11 + 4 * Math.cos(k * Math.PI / 12), 9 + 4 * Math.sin(k * Math.PI / 12)]), colors.text, 1.3);
      else if (index.paths.includes(kind)) line(pen, [[2, 13], [20, 5]], colors[kind] ?? colors.vehicle, 2);
      else if (kind === "contact") burst(pen, [[11, 9, 5]], 1.5);
      else disc(pen, 11, 9, 6.5, colors[kind] ?? colors.pedestrian, kind !== "unseen", kind === "noticed");
      return canvas;
    };
    const keys = { vehicle: "vehicle, its goal", pedestrian: "pedestrian" };
    if (stays.some(stay => stay.seen.includes(false))) keys.unseen = "not seen by the vehicle";
    if (stays.some(stay => stay.noticed.includes(true))) keys.noticed = "has noticed the vehicle";
    keys.contact = "contact";
    const choices = { numbers: "numbers" };
    for (const kind of index.paths) if (all.some(({ planned }) => planned.some(paths => paths[kind].length))) choices[kind] = kind === "measured" ? "measured or remembered" : `${kind} paths`;
    const toggle = ([value, text]) => {
      const checked = boxes.find(box => box.value === value)?.checked ?? value !== "numbers";
      const input = element("input", { type: "checkbox", value, checked, onchange: draw });
      return element("label", {}, input, ...value === "numbers" ? [] : [sample(value)], text);
    };
    $("marks").replaceChildren(...Object.entries(keys).map(([kind, text]) => element("span", {}, sample(kind), text)), ...Object.entries(choices).map(toggle));
  }

  function overview() {
    const canvas = $("overview"), { cases } = scenario, row = 8, width = $("panels").clientWidth, cell = Math.min(width / cases.length, 28), space = cell > 4 ? 1.5 : 0;
    const pen = resize(canvas, width, chosen.length * row);
    chosen.forEach((planner, line) => cases.forEach((which, k) => {
      const outcome = ending(planner, which), rect = [k * cell, line * row, cell - space, row - 1.5];
      if (outcome && !isKnown(planner, which)) {
        pen.fillStyle = colors.line;
        return pen.fillRect(k * cell, (line + 0.5) * row - 1.5, cell - space, 1.5);
      }
      pen.fillStyle = colors[{ s: "faint", c: "contact", w: "contact", t: "quiet" }[outcome]] ?? "transparent";
      pen.fillRect(...rect);
    }));
    Object.assign(pen, { strokeStyle: colors.vehicle, lineWidth: 2 }).strokeRect(cases.indexOf(number) * cell, 1, Math.max(cell - space, 2), chosen.length * row - 2.5);
    canvas.onclick = event => turn(cases[Math.floor(event.offsetX / cell)]);
    canvas.onmousemove = event => { canvas.title = cases[Math.floor(event.offsetX / cell)] ?? ""; };
  }

  // Pictures, in metres.

  function resize(canvas, width, height) {
    Object.assign(canvas.style, { width: `${width}px`, height: `${height}px` });
    Object.assign(canvas, { width: width * devicePixelRatio, height: height * devicePixelRatio });
    const pen = canvas.getContext("2d");
    pen.scale(devicePixelRatio, devicePixelRatio);
    return pen;
  }

  function fit() {
    overview();
    const all = Object.values(episodes), margin = Math.max(0.6, scenario.tolerance + 0.2, ...scenario.outline.map(point => Math.hypot(...point)));
    const spans = [0, 1].map(axis => {
      const values = [...all.flatMap(({ stays, goal }) => [goal[axis], ...stays.flatMap(stay => axis ? stay.y : stay.x)]), ...obstacles.flat().map(point => point[axis])];
      return [values.reduce((a, b) => Math.min(a, b)) - margin, values.reduce((a, b) => Math.max(a, b)) + margin];
    });
    const [wide, high] = spans.map(([low, top]) => top - low), counts = all.map((_, k) => k + 1), heightOf = id => $(id).offsetHeight + 10;
    const scaleOf = (columns, isBeside) => { // pixels in a metre, with the verdicts below or beside the pictures
      $("stage").classList.toggle("beside", isBeside);
      const below = heightOf("transport") + heightOf("legend") + (isBeside ? 0 : heightOf("verdicts"));
      const room = innerWidth < 640 ? innerHeight - heightOf("transport") : Math.max(innerHeight - $("panels").offsetTop - below, 320);
      return Math.min((($("panels").clientWidth + 10) / columns - 10) / wide, (room / Math.ceil(all.length / columns) - 62) / high);
    };
    const ways = counts.flatMap(columns => [[columns, false], ...innerWidth > 1000 ? [[columns, true]] : []]).map(way => [scaleOf(...way), ...way]);
    const [best, columns, isBeside] = ways.reduce((a, b) => b[0] > a[0] + 1e-9 ? b : a), scale = Math.max(best, 8);
    $("stage").classList.toggle("beside", isBeside && $("verdicts").children.length > 0);
    box = { left: spans[0][0], top: spans[1][1], scale };
    $("panels").style.gridTemplateColumns = `repeat(${columns}, ${Math.floor(scale * wide)}px)`;
    for (const { canvas } of all) resize(canvas, Math.floor(scale * wide), Math.floor(scale * high));
    draw();
  }

  function line(pen, points, strokeStyle, lineWidth) {
    pen.beginPath();
    for (const point of points) pen.lineTo(...point);
    Object.assign(pen, { strokeStyle, lineWidth }).stroke();
  }

  function star(pen, x, y, outer, inner, points) {
    const angle = k => Math.PI * (0.5 + k / points), radius = k => k % 2 ? inner : outer;
    const corners = Array.from({ length: 2 * points + 1 }, (_, k) => [x + radius(k) * Math.cos(angle(k)), y + radius(k) * Math.sin(angle(k))]);
    return width => line(pen, corners, colors[points > 5 ? "contact" : "vehicle"], width);
  }

  function disc(pen, x, y, radius, style, isSeen = true, hasNoticed = false) {
    pen.beginPath();
    pen.arc(x, y, radius, 0, 7);
    Object.assign(pen, { fillStyle: isSeen ? style : colors.background, strokeStyle: style, lineWidth: radius / 4 }).fill();
    pen.setLineDash([radius / 2, radius / 3.6]);
    if (!isSeen) pen.stroke();
    pen.setLineDash([]);
    if (hasNoticed) disc(pen, x, y, 0.4 * radius, colors.vehicle);
  }

  function burst(pen, discs, width) { // around all who are in contact
    const [x, y] = [0, 1].map(axis => discs.reduce((sum, each) => sum + each[axis] / discs.length, 0));
    const reach = Math.max(...discs.map(each => Math.hypot(each[0] - x, each[1] - y) + each[2]));
    star(pen, x, y, 1.7 * reach, 1.25 * reach, 12)(width);
  }

  function body(pen, x, y, heading, pixel) {
    pen.save();
    pen.translate(x, y);
    pen.rotate(heading);
    line(pen, scenario.outline, colors.background, pixel);
    Object.assign(pen, { fillStyle: colors.vehicle }).fill();
    const front = Math.max(...scenario.outline.map(point => point[0]));
    line(pen, [[front - 0.3, 0], [front, 0]], colors.background, 2.5 * pixel);
    pen.restore();
  }

  const between = (values, k) => { // two states, along a straight line
    const low = Math.min(Math.floor(k), values.length - 1);
    return values[low] + (k - low) * ((values[low + 1] ?? values[low]) - values[low]);
  };

  function paint(planner) {
    const { canvas, stays, planned, goal, steps, heading, hit, outcome } = episodes[planner], { scale, left, top } = box, pixel = 1 / scale;
    const state = Math.min(time / scenario.dt, steps), now = Math.floor(state + 1e-9), pen = canvas.getContext("2d"), zoom = scale * devicePixelRatio;
    const isShown = value => $("marks").querySelector(`[value=${value}]`)?.checked, place = ({ first, x, y }) => [between(x, state - first), between(y, state - first)];
    pen.setTransform(zoom, 0, 0, -zoom, -left * zoom, top * zoom);
    Object.assign(pen, { fillStyle: colors.background, lineJoin: "round", lineCap: "round" }).fillRect(left, top, 1e3, -1e3);
    for (const corners of obstacles) {
      line(pen, [...corners, corners[0]], colors.wall, 1.5 * pixel);
      Object.assign(pen, { fillStyle: colors.faint }).fill();
    }
    star(pen, ...goal, 0.2, 0.08, 5)(pixel);
    Object.assign(pen, { fillStyle: colors.vehicle }).fill();
    line(pen, [], colors.vehicle, 1.5 * pixel);
    pen.arc(...goal, scenario.tolerance, 0, 7);
    pen.stroke();
    const here = stays.filter(stay => stay.first <= state && state < stay.last + 1).reverse();
    for (const stay of here) {
      const walked = stay.x.slice(0, now - stay.first + 1).map((x, k) => [x, stay.y[k]]);
      line(pen, [...walked, place(stay)], stay.agent ? colors.walked : colors.vehicle, (stay.agent ? 1.5 : 3) * pixel);
    }
    for (const kind of state < steps && planned.length ? index.paths.filter(isShown) : [])
      for (const path of kind === "measured" ? [] : planned[now][kind]) line(pen, path, colors[kind] ?? colors.vehicle, (kind === "planned" ? 3 : 1.3) * pixel);
    for (const stay of here) {
      const { agent, radius, first, seen, noticed } = stay;
      if (agent || !scenario.outline.length) disc(pen, ...place(stay), radius, agent ? colors.pedestrian : colors.vehicle, seen[now - first], agent && noticed[now - first]);
      else body(pen, ...place(stay), between(heading, state), pixel);
    }
    for (const ring of isShown("measured") ? planned[now].measured : [])
      for (const [color, width] of [[colors.background, 3], [colors.text, 1.3]]) line(pen, ring, color, width * pixel);
    if (state >= steps && "cw".includes(outcome)) burst(pen, here.filter(({ agent }) => agent === 0 || agent === hit).map(stay => [...place(stay), stay.radius]), 2.5 * pixel);
    pen.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    Object.assign(pen, { fillStyle: colors.text, strokeStyle: colors.background, lineWidth: 3, font: "600 12px system-ui, sans-serif" });
    for (const stay of here.filter(({ agent }) => agent && (agent === hit && isKnown(planner, number) || isShown("numbers")))) {
      const [x, y] = place(stay), at = [stay.agent - 1, (x + 0.7 * stay.radius - left) * scale + 2, (top - y + 0.7 * stay.radius) * scale + 8];
      pen.strokeText(...at);
      pen.fillText(...at);
    }
    describe(episodes[planner], planner, now, here);
  }

  function describe({ canvas, caption, steps, gap, outcome }, planner, now, here) {
    const [sign, words] = ENDS[outcome], isOver = now >= steps, people = here.filter(({ agent }) => agent), nearest = gap[now - 1] / 100;
    caption.textContent = isOver ? `${sign} ${words}, ${(steps * scenario.dt).toFixed(2)} s` : nearest < 100 ? `gap ${nearest.toFixed(2)} m` : "";
    caption.className = isOver ? outcome : "";
    const seen = people.filter(stay => stay.seen[now - stay.first]).length;
    canvas.setAttribute("aria-label", `${planner} at ${time.toFixed(2)} s: ${caption.textContent || "start"}; the vehicle sees ${seen} of ${people.length} pedestrians`);
  }

  function draw() {
    chosen.forEach(paint);
    const ended = chosen.filter(planner => time >= episodes[planner].end - 1e-9 && !played.has(keyOf(planner, number)));
    for (const planner of ended) played.add(keyOf(planner, number));
    if (ended.length) tell();
    $("time").value = time;
    $("clock").textContent = `${time.toFixed(2)} s`;
    $("time").setAttribute("aria-valuetext", $("clock").textContent);
    if (!playing && decodeURI(location.hash) !== link()) history.replaceState(null, "", link());
  }

  // Time.

  function play(isWanted) {
    cancelAnimationFrame(playing);
    if (isWanted && time >= end) time = 0;
    playing = isWanted ? requestAnimationFrame(frame) : 0;
    before = undefined;
    $("play").textContent = isWanted ? "❚❚ Pause" : "▶ Play";
    draw();
    if (!isWanted) $("status").textContent = chosen.map(planner => episodes[planner].canvas.getAttribute("aria-label")).join(". ");
  }

  function frame(moment) {
    time = Math.min(end, time + (moment - (before ?? moment)) / 1000 * $("speed").value);
    before = moment;
    if (time >= end) return play(false);
    draw();
    playing = requestAnimationFrame(frame);
  }

  function seek(to) {
    time = Math.min(Math.max(to, 0), end);
    play(false);
  }

  const turn = which => which && show(name, which, chosen);
  const step = by => seek((Math.round(time / scenario.dt) + by) * scenario.dt);
  const move = by => turn(scenario.cases[scenario.cases.indexOf(number) + by]);
  const nextFailure = () => {
    const here = scenario.cases.indexOf(number) + 1;
    turn([...scenario.cases.slice(here), ...scenario.cases.slice(0, here)].find(fails));
  };
  const KEYS = {
    " ": () => play(!playing), ArrowLeft: () => step(-1), ArrowRight: () => step(1), Home: () => seek(0), End: () => seek(end),
    n: () => move(1), p: () => move(-1), f: nextFailure, o: () => $("outcomes").click(), j: () => $("verdicts").querySelector("button")?.click(),
  };

  function dress() {
    const mix = part => `color-mix(in srgb, ${palette.text} ${part}%, ${palette.background})`, palette = { ...index.palette[dark ? "dark" : "light"] };
    for (const role in palette) palette[role] = `rgb(${palette[role]})`;
    colors = { ...palette, page: mix(4), line: mix(25), quiet: dark ? "#a9adb6" : "#5f5f63" };
    for (const [role, color] of Object.entries(colors)) document.documentElement.style.setProperty(`--${role}`, color);
    document.documentElement.style.colorScheme = dark ? "dark" : "light";
  }

  async function start() {
    try {
      index = await load("index");
    } catch {
      $("about").textContent = "There are no data beside this page: write them with crowdbench export --format replay.";
      return;
    }
    for (const each of Object.values(index.scenarios)) {
      for (const run of Object.values(each.runs)) {
        const [split, first, stop] = run.cases.split(":");
        run.names = Array.from({ length: stop - first }, (_, k) => `${split}/${+first + k}`);
      }
      each.cases = [...new Set(Object.values(each.runs).flatMap(run => run.names))];
    }
    $("scenario").append(...Object.keys(index.scenarios).map(value => element("option", { value }, value)));
    if (index.back) $("back").replaceChildren(element("a", { href: index.back[0] }, `‹ ${index.back[1]}`));
    dress();
    await follow();
    addEventListener("hashchange", follow);
    addEventListener("resize", fit);
    addEventListener("keydown", event => {
      const { target, key } = event, action = KEYS[key] ?? (+key > 0 ? () => $("planners").children[key - 1]?.click() : null);
      if (!action || event.ctrlKey || event.metaKey || event.altKey || target.matches(key === " " ? "select, input[type=checkbox], button, summary" : "select")) return;
      event.preventDefault();
      action();
    });
    Object.entries({ previous: () => move(-1), next: () => move(1), failure: nextFailure, play: () => play(!playing) }).forEach(([id, onclick]) => { $(id).onclick = onclick; });
    $("outcomes").onclick = () => { areShown = !areShown; tell(); };
    $("scenario").onchange = event => show(event.target.value, "", chosen);
    $("case").onchange = event => turn(event.target.value);
    $("time").oninput = event => seek(+event.target.value);
    $("theme").onclick = () => { dark = !dark; dress(); explain(); fit(); };
  }

  addEventListener("DOMContentLoaded", start);
  return { take, get episodes() { return episodes; } };
})();
