// "Can you cross?": the reader drives the vehicle through a recorded crowd, beside the shipped planners on the same case.
// People do not see the vehicle, so that their tracks are exact for any drive. rules.js has the rules, cases/ the data, which
// are scripts because a page that is opened from a folder can read nothing else.
"use strict";

(() => {
  const BASE = document.currentScript.src;
  const { about } = cross, CASES = about.collided.length;
  const SHOWN = 6.3; // metres on each side of the middle
  const COUNTDOWN = 0.9, PAUSE = 2; // seconds before a drive, and at the end of a demonstration
  const RATES = { demo: 1.5, drive: 1, over: 2 }; // of time
  const FULL = 0.5; // metres to the pointer from which the vehicle drives at its full speed
  const KEYS = {
    ArrowUp: [0, 1], ArrowDown: [0, -1], ArrowLeft: [-1, 0], ArrowRight: [1, 0], w: [0, 1], s: [0, -1], a: [-1, 0], d: [1, 0],
  };
  const ENDS = { success: "s", collision: "c", timeout: "t" };
  const COLORS = ["vehicle", "pedestrian", "contact", "success", "faint", "ink", "ground"];
  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  const root = document.getElementById("cross"), find = name => root.querySelector(`[data-cross=${name}]`);
  const canvas = find("canvas"), pen = canvas.getContext("2d"), list = find("list"), sensing = find("sensing");
  const scenes = {}, waiting = {}, pressed = new Set();

  let scene, number = 0, phase = "demo", time = 0, shown = SHOWN, width = 0, colors = {}, last = 0, request = 0, isVisible = true;
  let commands = [], states = [], guest = null, pointer = null, picked = "", watched = [], announced = "", seen = { key: "", points: [] };

  // Cases and links: #val/3, #val/3/COMMANDS of an attempt, #val/3:mppi,orca with planners to watch, #day.

  cross.take = data => { scenes[data.case] = prepare(cross.open(data)); };

  const load = which => waiting[which] ??= new Promise((done, fail) => {
    const script = document.createElement("script");
    script.src = new URL(`cases/${which}.js`, BASE).href;
    script.onload = () => done(scenes[`val/${which}`]);
    script.onerror = () => fail(new Error(`${script.src} cannot be read`));
    document.head.append(script);
  });

  const today = () => Math.floor(Date.now() / 86400000) % CASES;

  async function show(which, attempt = "") {
    number = which;
    const found = await load(which);
    if (number !== which) return;
    scene = found;
    guest = attempt ? lane("link", cross.drive(scene, cross.decode(attempt))) : null;
    enter("demo");
  }

  function follow() {
    const [, which, names, attempt] = location.hash.match(/^#val\/(\d+)(?::([\w,]+))?(?:\/([\w-]+))?$/) ?? [];
    watched = names?.split(",") ?? [];
    if (which !== undefined && +which < CASES) return show(+which, attempt);
    if (location.hash && location.hash !== "#day") return scene ?? show(about.first); // a heading of the page
    return show(location.hash ? today() : about.first);
  }

  const link = () => `#${scene.case}${states.length > 1 && phase === "over" ? `/${cross.encode(commands)}` : ""}`;
  const go = which => { watched = []; history.replaceState(null, "", `#val/${which}`); show(which); };

  // Lanes: the path of a planner, of the reader, or of the attempt in a link. A contact ends it within its last step.

  function prepare(opened) {
    const planners = opened.planners.map(planner => {
      const ends = planner.at.map(([x, y], step) => ({ x, y, step }));
      return { ...planner, ...stop(opened, ends, planner.outcome) };
    });
    return { ...opened, planners, longest: Math.max(...planners.map(planner => planner.end)) };
  }

  const lane = (name, driven) => ({
    name, outcome: driven.at(-1).outcome, score: cross.score(scene, driven.at(-1)), at: driven.map(({ x, y }) => [x, y]),
    ...stop(scene, driven, driven.at(-1).outcome), steps: driven.length - 1,
  });

  function stop(opened, driven, outcome) {
    const steps = driven.length - 1;
    if (outcome !== "collision" || !steps) return { end: steps * opened.dt };
    const [from, to] = driven.slice(-2), dx = to.x - from.x, dy = to.y - from.y;
    const shares = opened.people.filter(person => cross.isThere(person, steps - 1)).map(person => {
      const [px, py] = person.at[steps - 1], [qx, qy] = person.at[steps], size = person.radius + opened.radius;
      const x = px - from.x, y = py - from.y, vx = qx - px - dx, vy = qy - py - dy;
      const a = vx * vx + vy * vy, b = x * vx + y * vy, c = x * x + y * y - size * size, root = b * b - a * c;
      return root >= 0 && a > 0 && b < 0 ? Math.max((-b - Math.sqrt(root)) / a, 0) : 1;
    });
    return { end: (steps - 1 + Math.min(1, ...shares)) * opened.dt };
  }

  function between(track, moment) {
    const place = Math.min(Math.max(moment / scene.dt, 0), track.length - 1), k = Math.min(Math.floor(place), track.length - 2);
    if (track.length < 2) return track[0];
    const share = place - k;
    return [track[k][0] + share * (track[k + 1][0] - track[k][0]), track[k][1] + share * (track[k + 1][1] - track[k][1])];
  }

  // Phases: demo, ready, drive, over.

  function enter(next) {
    phase = next;
    root.dataset.phase = next;
    if (next === "demo") { commands = []; states = []; time = 0; }
    if (next === "ready") { commands = []; states = [cross.start(scene)]; time = -COUNTDOWN; canvas.focus({ preventScroll: true }); }
    pressed.clear();
    if (next !== "drive") pointer = null;
    tell();
    wake();
  }

  function begin() {
    if (!scene) return;
    enter("ready");
    const { top, bottom } = canvas.getBoundingClientRect();
    if (top < 0 || bottom > innerHeight) canvas.scrollIntoView({ block: "center", behavior: calm.matches ? "auto" : "smooth" });
  }

  function wish() {
    let x = 0, y = 0;
    for (const key of pressed) { x += KEYS[key][0]; y += KEYS[key][1]; }
    let speed = scene.speed;
    if (!x && !y && pointer) {
      const here = states.at(-1);
      [x, y] = [pointer[0] - here.x, pointer[1] - here.y];
      speed *= Math.min(Math.hypot(x, y) / FULL, 1);
    }
    const size = Math.hypot(x, y);
    return cross.round(size ? [x * speed / size, y * speed / size] : [0, 0]);
  }

  function advance(seconds) {
    if (phase === "ready") {
      time += seconds;
      if (time < 0) return;
      time = 0;
      enter("drive");
    } else time += seconds * RATES[phase];
    if (phase === "drive") {
      while (!states.at(-1).outcome && time >= (states.length - 1) * scene.dt) {
        commands.push(wish());
        states.push(cross.step(scene, states.at(-1), commands.at(-1)));
      }
      if (states.at(-1).outcome && time >= mine().end) { time = mine().end; enter("over"); finish(); }
    }
    if (phase === "demo" && time > Math.max(scene.longest, guest?.end ?? 0) + PAUSE) time = 0;
  }

  const mine = () => lane("you", states);

  // The frame.

  function frame(now) {
    request = 0;
    const seconds = Math.min((now - last) / 1000, 0.1);
    last = now;
    if (!scene) return;
    if (!(phase === "demo" && calm.matches)) advance(seconds);
    draw();
    fillList();
    if (phase !== "over" || time < Math.max(scene.longest, ...states.length ? [mine().end] : []) + 1) wake();
  }

  function wake() {
    if (!request && isVisible) request = requestAnimationFrame(now => { if (now - last > 200) last = now; frame(now); });
  }

  function resize() {
    const ratio = Math.min(devicePixelRatio || 1, 2), size = Math.round(canvas.clientWidth * ratio);
    if (size && size !== width) canvas.width = canvas.height = width = size;
    wake();
  }

  function paint() {
    const style = getComputedStyle(root);
    colors = Object.fromEntries(COLORS.map(name => [name, style.getPropertyValue(`--cross-${name}`).trim()]));
    wake();
  }

  const pixel = ([x, y]) => [width / 2 * (1 + x / shown), width / 2 * (1 - y / shown)];
  const metres = event => {
    const box = canvas.getBoundingClientRect();
    return [(2 * (event.clientX - box.left) / box.width - 1) * shown, (1 - 2 * (event.clientY - box.top) / box.height) * shown];
  };

  function draw() {
    const moment = Math.max(time, 0), you = states.length ? mine() : null, here = you ? between(you.at, Math.min(moment, you.end)) : null;
    const reach = Math.max(SHOWN, ...(here ?? []).map(value => Math.abs(value) + 0.8));
    shown += (reach - shown) * 0.2;
    const scale = width / 2 / shown, ratio = width / canvas.clientWidth;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.fillStyle = colors.ground;
    pen.fillRect(0, 0, width, width);
    pen.lineWidth = ratio;
    pen.strokeStyle = colors.faint;
    pen.globalAlpha = 0.5;
    pen.beginPath();
    for (let line = -Math.floor(shown / 2) * 2; line <= shown; line += 2) {
      const [x, y] = pixel([line, line]);
      pen.moveTo(x, 0); pen.lineTo(x, width); pen.moveTo(0, y); pen.lineTo(width, y);
    }
    pen.stroke();
    pen.globalAlpha = 1;
    goal(scale, ratio);
    const isMeasured = sensing.checked, vehicle = here ?? (guest ? between(guest.at, Math.min(moment, guest.end)) : null);
    people(moment, scale, ratio, isMeasured && vehicle ? (phase === "over" ? 0.22 : 0) : 1);
    if (isMeasured && vehicle) measurements(moment, scale, ratio);
    for (const planner of scene.planners) ghost(planner, moment, scale, ratio, isWatched(planner) ? 1 : watched.length ? 0.15 : 0.3);
    if (guest) ghost(guest, moment, scale, ratio, 0.85);
    if (you) reader(you, here, moment, scale, ratio);
    if (phase === "ready") words("Ready", [0, 0], 34 * ratio, colors.ink);
  }

  const isWatched = planner => planner.name === picked || watched.includes(planner.name);
  const disc = (at, radius) => { const [x, y] = pixel(at); pen.beginPath(); pen.arc(x, y, radius, 0, 2 * Math.PI); };

  function words(text, at, size, color, lift = 0) {
    const [x, y] = pixel(at);
    pen.font = `600 ${size}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.lineJoin = "round";
    pen.lineWidth = size / 3.5;
    pen.strokeStyle = colors.ground;
    pen.strokeText(text, x, y - lift);
    pen.fillStyle = color;
    pen.fillText(text, x, y - lift);
  }

  function goal(scale, ratio) {
    const [x, y] = pixel(scene.goal), size = 0.42 * scale;
    disc(scene.goal, scene.radius * scale * 1.9);
    pen.fillStyle = colors.success;
    pen.globalAlpha = 0.14;
    pen.fill();
    pen.globalAlpha = 1;
    pen.beginPath();
    for (let k = 0; k < 10; k++) {
      const angle = Math.PI * (k / 5 - 0.5), r = k % 2 ? size * 0.42 : size;
      pen.lineTo(x + r * Math.cos(angle), y + r * Math.sin(angle));
    }
    pen.fill();
    if (phase === "demo" || phase === "ready") words("goal", scene.goal, 12 * ratio, colors.success, (scene.goal[1] > 0 ? 1 : -1) * 0.95 * scale);
  }

  function people(moment, scale, ratio, alpha) {
    if (!alpha) return;
    for (const person of scene.people) {
      const end = (person.at.length - 1) * scene.dt;
      if (person.left && moment > end + 0.3) continue;
      const at = between(person.at, moment), behind = between(person.at, Math.min(moment, end) - 0.9);
      const [x, y] = pixel(at), [bx, by] = pixel(behind), fade = person.left ? Math.min(1, (end + 0.3 - moment) / 0.3) : 1;
      pen.globalAlpha = 0.2 * alpha * fade;
      pen.strokeStyle = pen.fillStyle = colors.pedestrian;
      pen.lineWidth = 0.34 * scale;
      pen.lineCap = "round";
      pen.beginPath(); pen.moveTo(bx, by); pen.lineTo(x, y); pen.stroke();
      pen.globalAlpha = alpha * fade;
      disc(at, person.radius * scale);
      pen.fill();
    }
    pen.globalAlpha = 1;
  }

  function ghost(planner, moment, scale, ratio, alpha) {
    const end = planner.end, at = between(planner.at, Math.min(moment, end)), isOver = moment >= end, [x, y] = pixel(at);
    const size = scene.radius * scale, isNew = isOver && moment - end < 1.2 && end > 0;
    if (isOver && planner.outcome === "success" && !isNew) return;
    if (isOver && planner.outcome === "collision") {
      pen.globalAlpha = Math.max(alpha, isNew ? 0.9 : 0.45);
      burst(x, y, size * 0.75, ratio);
    } else {
      pen.globalAlpha = alpha;
      pen.fillStyle = colors.vehicle;
      disc(at, size);
      pen.fill();
      pen.globalAlpha = Math.min(1, alpha + 0.3);
      pen.strokeStyle = colors.vehicle;
      pen.lineWidth = 1.3 * ratio;
      pen.stroke();
    }
    pen.globalAlpha = 1;
    const isNamed = isWatched(planner) || planner === guest || (isNew && !watched.length && phase !== "drive" && phase !== "ready");
    if (isNamed) words(planner.name, at, 12 * ratio, planner.outcome === "collision" && isOver ? colors.contact : colors.ink, size + 9 * ratio);
  }

  function burst(x, y, size, ratio) {
    pen.strokeStyle = colors.contact;
    pen.lineWidth = 2.6 * ratio;
    pen.lineCap = "round";
    pen.beginPath();
    for (const [dx, dy] of [[1, 1], [1, -1]]) { pen.moveTo(x - dx * size, y - dy * size); pen.lineTo(x + dx * size, y + dy * size); }
    pen.stroke();
  }

  function reader(you, here, moment, scale, ratio) {
    const size = scene.radius * scale, [x, y] = pixel(here), isOver = phase === "over" && moment >= you.end - 1e-9;
    pen.strokeStyle = colors.vehicle;
    pen.lineWidth = 2.5 * ratio;
    pen.globalAlpha = 0.7;
    pen.beginPath();
    for (let k = 0; k * scene.dt < Math.min(moment, you.end); k++) pen.lineTo(...pixel(you.at[k]));
    pen.lineTo(x, y);
    pen.stroke();
    if (pointer && phase === "drive") {
      const [px, py] = pixel(pointer);
      pen.setLineDash([3 * ratio, 5 * ratio]);
      pen.beginPath(); pen.moveTo(x, y); pen.lineTo(px, py); pen.stroke();
      pen.setLineDash([]);
    }
    pen.globalAlpha = 1;
    disc(here, size);
    pen.fillStyle = colors.vehicle;
    pen.fill();
    pen.strokeStyle = colors.ink;
    pen.lineWidth = 2 * ratio;
    pen.stroke();
    if (phase === "ready") { disc(here, size * (1.5 - time)); pen.stroke(); }
    if (phase === "ready" || (phase === "drive" && time < 1.2)) words("you", here, 13 * ratio, colors.ink, size + 10 * ratio);
    if (isOver && you.outcome === "collision") burst(x, y, size * 1.15, ratio * 1.5);
  }

  // Measurements of the detector of the track "realistic": range, occlusion, noise, missed and false detections.

  function measurements(moment, scale, ratio) {
    const of = states.length ? states.map(({ x, y }) => [x, y]) : guest.at, step = Math.min(Math.floor(moment / scene.dt + 1e-9), of.length - 1);
    const key = `${scene.case}/${step}/${of[step]}`;
    if (seen.key !== key) seen = { key, points: measure(of[step], step) };
    pen.strokeStyle = colors.pedestrian;
    pen.lineWidth = 2 * ratio;
    for (const at of seen.points) { disc(at, about.sensor.radius * scale); pen.stroke(); }
  }

  function measure(vehicle, step) {
    let seed = (number + 1) * 7919 + step * 104729;
    const uniform = () => { // mulberry32
      seed = seed + 0x6D2B79F5 | 0;
      let t = Math.imul(seed ^ seed >>> 15, 1 | seed);
      t = t + Math.imul(t ^ t >>> 7, 61 | t) ^ t;
      return ((t ^ t >>> 14) >>> 0) / 4294967296;
    };
    const normal = () => Math.sqrt(-2 * Math.log(1 - uniform())) * Math.cos(2 * Math.PI * uniform());
    const { range, position, missed, radius } = about.sensor, points = [];
    const around = scene.people.filter(person => cross.isThere(person, step)).map(person => ({ radius: person.radius, at: person.at[step] }));
    for (const person of around) {
      const noise = [normal(), normal()], isMissed = uniform() < missed, away = Math.hypot(person.at[0] - vehicle[0], person.at[1] - vehicle[1]);
      if (isMissed || away - scene.radius - person.radius > range || isHidden(person, vehicle, around)) continue;
      points.push(person.at.map((value, i) => value + position * noise[i]));
    }
    for (let share = uniform(), n = 1, chance = Math.exp(-about.sensor.false); share >= chance && n < 6; n++) { // Poisson
      share -= chance;
      chance *= about.sensor.false / n;
      const nearest = scene.radius + radius, squared = nearest ** 2 + uniform() * ((range + nearest) ** 2 - nearest ** 2), angle = 2 * Math.PI * uniform();
      const at = [vehicle[0] + Math.sqrt(squared) * Math.cos(angle), vehicle[1] + Math.sqrt(squared) * Math.sin(angle)];
      if (!isHidden({ at, radius }, vehicle, [])) points.push(at);
    }
    return points;
  }

  // A person is hidden if others cover its middle and both ends of its diameter across the line of sight.
  function isHidden(person, [vx, vy], around) {
    const dx = person.at[0] - vx, dy = person.at[1] - vy, across = person.radius / (Math.hypot(dx, dy) || 1);
    return [0, 1, -1].every(side => {
      const tx = dx - side * across * dy, ty = dy + side * across * dx;
      return around.some(other => {
        const bx = other.at[0] - vx, by = other.at[1] - vy, along = bx * tx + by * ty;
        if (other === person || along <= 0) return false;
        const share = Math.min(along / (tx * tx + ty * ty), 1);
        return (bx - share * tx) ** 2 + (by - share * ty) ** 2 < other.radius ** 2;
      });
    });
  }

  // Words beside the picture.

  const seconds = value => `${value.toFixed(2).replace(/0$/, "")} s`;
  const ordinal = n => `${n}${(n % 100 < 11 || n % 100 > 13) && { 1: "st", 2: "nd", 3: "rd" }[n % 10] || "th"}`;
  const collided = () => about.collided[number];
  const entries = () => [...scene.planners, ...guest ? [guest] : [], ...states.length ? [mine()] : []];

  function tell() {
    find("case").textContent = `Case ${scene.case}`;
    find("lead").textContent = guest
      ? `Somebody ${guest.outcome === "success" ? `crossed this crowd in ${seconds(guest.steps * scene.dt)}` : guest.outcome === "collision" ? `was stopped by this crowd after ${seconds(guest.steps * scene.dt)}` : "ran out of time in this crowd"}. Can you do better?`
      : watched.length ? `Watch ${watched.join(" and ")} in this crowd, or drive yourself. ${collided()} of ${scene.planners.length} planners collide here.`
      : `Twenty people cross this circle, and none of them sees the robot. Bring it to the star. ${collided()} of ${scene.planners.length} planners collide here.`;
    canvas.setAttribute("aria-label", `Top view of case ${scene.case}: the vehicle, ${scene.people.length} pedestrians and ${scene.planners.length} planners. Drive with the arrow keys.`);
  }

  function finish() {
    const you = mine(), all = entries().sort((a, b) => b.score - a.score), place = all.findIndex(each => each.name === "you") + 1;
    const planners = scene.planners.length, hit = collided();
    const verdict = {
      success: `You crossed in ${seconds(you.steps * scene.dt)}.`,
      collision: `You collided after ${seconds(you.end)}.`,
      timeout: `You ran out of time after ${seconds(you.end)}.`,
    }[you.outcome];
    find("verdict").textContent = verdict;
    find("score").textContent = you.outcome === "success"
      ? `Score ${you.score.toFixed(2)}, ${ordinal(place)} of ${all.length}. ${hit} of ${planners} planners collided here.`
      : `${you.outcome === "collision" ? `So did ${hit}` : `${hit}`} of ${planners} planners${you.outcome === "collision" ? "" : " collided here"}; the best one scored ${Math.max(...scene.planners.map(each => each.score)).toFixed(2)}.`;
    history.replaceState(null, "", link());
    find("again").focus({ preventScroll: true });
  }

  function fillList() {
    const moment = phase === "over" && time >= scene.longest ? Infinity : Math.max(time, 0);
    const all = entries(), isOver = each => moment >= each.end && (each.name !== "you" || phase === "over");
    const key = `${scene.case} ${phase} ${all.map(each => +isOver(each)).join("")}`;
    const driving = all.filter(each => !isOver(each)).length;
    find("clock").textContent = phase === "demo" ? "" : seconds(Math.floor(Math.max(Math.min(time, states.length ? mine().end : time), 0) * 10) / 10);
    if (key === announced) return;
    announced = key;
    const weight = each => (isOver(each) ? { success: 2, timeout: -1, collision: -2 }[each.outcome] : 1);
    const rows = all.sort((a, b) => weight(b) - weight(a) || (isOver(a) ? b.score - a.score || b.end - a.end : 0));
    list.replaceChildren(...rows.map(each => {
      const row = document.createElement("li"), name = document.createElement("b"), text = document.createElement("span");
      row.className = `${isOver(each) ? ENDS[each.outcome] : "d"} ${each.name === "you" ? "you" : ""}`;
      row.dataset.name = each.name;
      name.textContent = each.name;
      text.textContent = !isOver(each) ? "driving" : each.outcome === "success" ? `${seconds(each.steps * scene.dt)} · ${each.score.toFixed(2)}` : `${each.outcome === "collision" ? "✗" : "time-out"} ${seconds(each.end)}`;
      row.append(name, text);
      return row;
    }));
    const count = outcome => scene.planners.filter(each => isOver(each) && each.outcome === outcome).length;
    find("counts").textContent = `Planners: ${count("success")} arrived, ${count("collision")} collided, ${scene.planners.length - count("success") - count("collision") - count("timeout")} driving`;
  }

  function download() {
    const attempt = { planner: "human", scenario: about.scenario, case: scene.case, commands };
    const anchor = document.createElement("a");
    anchor.href = URL.createObjectURL(new Blob([JSON.stringify(attempt)], { type: "application/json" }));
    anchor.download = `attempt-${scene.case.replace("/", "-")}.json`;
    anchor.click();
    URL.revokeObjectURL(anchor.href);
  }

  async function share() {
    const button = find("share"), address = location.href.replace(/#.*/, "") + link();
    try {
      await navigator.clipboard.writeText(address);
      button.textContent = "Link copied";
      setTimeout(() => { button.textContent = "Copy link"; }, 2000);
    } catch { prompt("The link to this attempt", address); }
  }

  // Input.

  const actions = {
    start: begin, again: begin, next: () => go((number + 1) % CASES), other: () => go((number + 1) % CASES), day: () => go(today()), share, download,
    watch: () => { time = 0; wake(); },
  };
  for (const [name, act] of Object.entries(actions)) find(name).addEventListener("click", act);
  sensing.addEventListener("change", () => { if (phase === "over") time = 0; wake(); });

  document.addEventListener("keydown", event => {
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (event.ctrlKey || event.metaKey || event.altKey || !["ready", "drive"].includes(phase)) return;
    if (key === "Escape") enter("demo");
    else if (KEYS[key]) pressed.add(key);
    else return;
    event.preventDefault();
    event.stopPropagation(); // the theme searches on s
  }, true);
  document.addEventListener("keyup", event => pressed.delete(event.key.length === 1 ? event.key.toLowerCase() : event.key), true);
  addEventListener("blur", () => pressed.clear());
  canvas.addEventListener("keydown", event => { if (event.key === "Enter" && (phase === "demo" || phase === "over")) begin(); });
  canvas.addEventListener("click", () => { if (phase === "demo" || phase === "over") begin(); });
  canvas.addEventListener("pointerdown", event => {
    if (phase !== "ready" && phase !== "drive") return;
    canvas.setPointerCapture(event.pointerId);
    pointer = metres(event);
    event.preventDefault();
  });
  canvas.addEventListener("pointermove", event => { if (pointer) pointer = metres(event); });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, () => { pointer = null; });
  list.addEventListener("pointerover", event => { picked = event.target.closest("li")?.dataset.name ?? ""; wake(); });
  list.addEventListener("pointerleave", () => { picked = ""; wake(); });

  // A picture of the demonstration for docs/cross_film.py.
  cross.pose = moment => {
    enter("demo");
    time = moment;
    draw();
    const hit = scene.planners.filter(each => each.outcome === "collision" && moment >= each.end).length, ratio = width / canvas.clientWidth;
    words(`${hit} of ${scene.planners.length} planners collided`, [0, -shown], 17 * ratio, colors.ink, 20 * ratio);
    return canvas.toDataURL();
  };
  cross.isOpen = () => Boolean(scene);

  new ResizeObserver(resize).observe(canvas);
  new MutationObserver(paint).observe(document.body, { attributes: true, attributeFilter: ["data-md-color-scheme"] });
  new IntersectionObserver(([entry]) => { isVisible = entry.isIntersecting; wake(); }).observe(canvas);
  document.addEventListener("visibilitychange", () => pressed.clear());
  addEventListener("hashchange", follow);
  paint();
  follow();
})();
