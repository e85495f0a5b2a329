// The rules of an episode on the start page: limit of speed, contact, arrival, time-out and score, for a vehicle that is a
// disc and moves in any direction. They are those of crowdbench/core/dynamics/kernels.py, sim/episode.py and
// metrics/score.py; tests/repository/test_cross.py compares their results with the simulator.
"use strict";

var cross = (() => {
  const DIGITS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";
  const FINE = 1e-5, COARSE = 2e-3; // metres: resolution of the tracks of people, and of planners
  const GRAIN = 200; // commands are multiples of 1 / GRAIN m/s, so that a link has them exactly
  const SPEED_TOLERANCE = 1e-6;
  const CLOSE = 0.3, FAR = 0.6, SAMPLE = 0.02; // metres, see the score

  // Integers as a text: base 32 with the lowest digit first, the lowest bit is the sign.
  function unpack(text) {
    const values = [];
    for (let at = 0; at < text.length;) {
      let value = 0, shift = 1, digit;
      do {
        digit = DIGITS.indexOf(text[at++]);
        value += (digit & 31) * shift;
        shift *= 32;
      } while (digit > 31);
      values.push(value % 2 ? (1 - value) / 2 : value / 2);
    }
    return values;
  }

  function pack(values) {
    let text = "";
    for (const value of values) {
      let rest = value < 0 ? 1 - 2 * value : 2 * value;
      do {
        text += DIGITS[(rest & 31) + (rest > 31 ? 32 : 0)];
        rest >>= 5;
      } while (rest);
    }
    return text;
  }

  const length = (x, y) => Math.sqrt(x * x + y * y);
  const sums = values => { let sum = 0; return values.map(value => sum += value); };

  function track(text, quantum) {
    const values = unpack(text), half = values.length / 2;
    const axis = part => sums(sums(part)).map(value => value * quantum);
    const x = axis(values.slice(0, half)), y = axis(values.slice(half));
    return x.map((each, i) => [each, y[i]]);
  }

  // A case with the positions of people and planners at each state.
  function open(data) {
    const people = data.people.map(person => ({ ...person, at: track(person.track, FINE) }));
    const planners = data.planners.map(planner => ({ ...planner, at: track(planner.track, COARSE) }));
    return { ...data, people, planners };
  }

  const start = ({ start: [x, y] }) => ({ step: 0, x, y, vx: 0, vy: 0, close: 0, gap: Infinity, outcome: "" });

  // A person counts in a step that begins before its last state, which is its arrival if it leaves.
  const isThere = (person, step) => step < person.at.length - 1;

  function step(scene, before, [wishX, wishY]) {
    const { dt, radius, goal } = scene, t = before.step, speed = Math.sqrt(wishX * wishX + wishY * wishY);
    const share = speed > scene.speed * (1 + SPEED_TOLERANCE) ? scene.speed / speed : 1;
    const vx = wishX * share, vy = wishY * share, x = before.x + vx * dt, y = before.y + vy * dt;
    let gap = Infinity;
    for (const person of scene.people) {
      if (isThere(person, t)) gap = Math.min(gap, nearest(before, vx * dt, vy * dt, person, t) - person.radius - radius);
    }
    const dx = goal[0] - x, dy = goal[1] - y;
    const isLast = t + 1 >= scene.steps, isHit = gap < 0, isNear = Math.sqrt(dx * dx + dy * dy) < radius;
    const outcome = isLast ? "timeout" : isHit ? "collision" : isNear ? "success" : "";
    const after = { step: t + 1, x, y, vx, vy, gap, outcome };
    return { ...after, close: before.close + secondsClose(scene, before, after) };
  }

  // The smallest distance between the centres of the vehicle and of a person in a step, in which both move straight.
  function nearest(vehicle, moveX, moveY, person, t) {
    const [px, py] = person.at[t], [qx, qy] = person.at[t + 1];
    const x = px - vehicle.x, y = py - vehicle.y, dx = qx - px - moveX, dy = qy - py - moveY, squared = dx * dx + dy * dy;
    const share = squared > 0 ? Math.min(Math.max(-(x * dx + y * dy) / squared, 0), 1) : 0;
    return length(x + share * dx, y + share * dy);
  }

  function secondsClose(scene, before, after) {
    const t = before.step, dx = after.x - before.x, dy = after.y - before.y;
    let seconds = 0;
    for (const person of scene.people) {
      const leaves = person.left && t + 2 >= person.at.length && !after.outcome;
      if (!isThere(person, t) || leaves) continue;
      const [px, py] = person.at[t], [qx, qy] = person.at[t + 1], size = person.radius + scene.radius;
      const way = length(dx, dy) + length(qx - px, qy - py);
      if (length(px - before.x, py - before.y) - size - way >= FAR) continue;
      const samples = Math.max(1, Math.ceil(way / SAMPLE));
      for (let k = 0; k < samples; k++) {
        const share = (k + 0.5) / samples;
        const gap = length(px + share * (qx - px) - before.x - share * dx, py + share * (qy - py) - before.y - share * dy) - size;
        seconds += Math.min(Math.max((FAR - gap) / (FAR - CLOSE), 0), 1) * scene.dt / samples;
      }
    }
    return seconds;
  }

  function score(scene, state) {
    return state.outcome === "success" ? scene.least / (Math.max(state.step * scene.dt, scene.least) + state.close) : 0;
  }

  // All states of an episode from its commands; the vehicle stands after the last one.
  function drive(scene, commands) {
    const states = [start(scene)];
    while (!states.at(-1).outcome) states.push(step(scene, states.at(-1), commands[states.length - 1] ?? [0, 0]));
    return states;
  }

  // Commands are rounded towards zero, so that none is faster than the vehicle.
  const round = ([vx, vy]) => [Math.trunc(vx * GRAIN) / GRAIN, Math.trunc(vy * GRAIN) / GRAIN];
  const differences = values => values.map((value, i) => value - (values[i - 1] ?? 0));

  function encode(commands) {
    const axis = i => differences(commands.map(command => Math.round(command[i] * GRAIN)));
    return pack([...axis(0), ...axis(1)]);
  }

  function decode(text) {
    const values = unpack(text), half = values.length / 2, axis = part => sums(part).map(value => value / GRAIN);
    const x = axis(values.slice(0, half)), y = axis(values.slice(half));
    return x.map((each, i) => [each, y[i]]);
  }

  return { open, start, step, drive, score, isThere, round, encode, decode };
})();
