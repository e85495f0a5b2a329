// Prints the outcome, the number of steps and the score of attempts, for tests/repository/test_cross.py:
// node tests/cross_outcomes.js < {"cases": {"3": FILE}, "attempts": [["3", [[vx, vy], ...]], ...]}
"use strict";
const fs = require("fs"), path = require("path"), vm = require("vm");

vm.runInThisContext(fs.readFileSync(path.join(__dirname, "../docs/cross/rules.js"), "utf8"));
const { cases, attempts } = JSON.parse(fs.readFileSync(0, "utf8")), scenes = {};
for (const [name, file] of Object.entries(cases)) {
  cross.take = data => { scenes[name] = cross.open(data); };
  vm.runInThisContext(fs.readFileSync(file, "utf8"));
}
const results = attempts.map(([name, commands]) => {
  const scene = scenes[name], last = cross.drive(scene, cross.decode(cross.encode(commands))).at(-1);
  return [last.outcome, last.step, cross.score(scene, last)];
});
process.stdout.write(JSON.stringify(results));
