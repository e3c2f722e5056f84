// The live page: what comes over the WebSocket is shown, what is pressed is asked for.

import { Plot } from "./plots.js";
import { Scene } from "./scene.js";

const token = new URLSearchParams(location.search).get("token") || "";
const $ = (id) => document.getElementById(id);
const KEPT = 900;       // samples, as the server's
const JOG_PERIOD = 100; // ms; the robot stops when nothing comes for three of them
const state = { limits: {}, choices: {}, values: {}, names: [], samples: [], told: {}, factor: null };
let socket = null, scene = null, robotOf = null, dirty = true, positions = {};
let sceneless = "", refused = 0;  // why there is no scene; connections refused one after the other

try {
  scene = new Scene($("scene"));
} catch (error) {
  sceneless = String(error.message || error);
  trouble(sceneless);
}
const plots = [
  new Plot($("plot-error"), (s) => s[1]),
  new Plot($("plot-velocity"), (s) => s[2].slice(0, 3), (s) => s[3].slice(0, 3)),
  new Plot($("plot-turn"), (s) => s[2].slice(3), (s) => s[3].slice(3)),
];
plots[1].names = ["vx", "vy", "vz"];
plots[2].names = ["ωx", "ωy", "ωz"];

function trouble(text) {
  $("trouble").textContent = text;
  $("trouble").hidden = !text;
}

// -- what is asked for -------------------------------------------------------------------

const running = new Map();  // requests that are being carried out: since when, ms
const LOST = "no connection to the simulator", NOBODY = "no controller runs: start the nodes with a scheme";
const loop = () => state.values.controller ? "" : NOBODY;
// Why a request cannot be carried out now, "" where it can; those that are not here always can.
const UNABLE = {
  start: loop, stop: loop, hold: loop,
  goal: () => (state.limits.names || []).length ? "" : "there is no robot yet",
  target: () => state.values.no_target ? `${state.values.no_target}, whose place it could take` :
    (state.choices.targets || []).length ? "" : "there are no targets to choose from",
  teach: () => $("teach-name").value ? "" : "give the goal a name first",
  record: () => state.values.recording && !state.values.trouble ? "a bag is being recorded already" : "",
  stop_record: () => state.values.recording ? "" : "nothing is being recorded",
  report: () => state.values.recording ? "a bag is being recorded: stop that first"
    : state.values.recorded ? "" : "nothing has been recorded yet",
};
// The fields of those that have some.
const FIELDS = {
  step: () => ({ steps: +$("steps").value }),
  servo: () => ({ scheme: $("choose-scheme").value, law: $("choose-law").value,
    start: $("choose-start").value, goal: $("choose-goal").value }),
  goal: () => Object.fromEntries(Object.entries(goalRows).map(([k, row]) => [k, +row.input.value])),
  camera: () => ({ preset: $("choose-camera").value }),
  target: () => ({ name: $("choose-target").value }),
  teach: () => ({ name: $("teach-name").value }),
};

function connected() { return socket !== null && socket.readyState === WebSocket.OPEN; }

function unable(what) {
  if (!connected()) return LOST;
  if (running.has(what)) return "that is being carried out";
  return what in UNABLE ? UNABLE[what]() : "";
}

function ask(request) {
  if (!connected()) { say({ done: false, text: LOST }); return; }
  if (!request.do.startsWith("jog")) {  // those come ten times a second
    running.set(request.do, performance.now());
    begin();
  }
  socket.send(JSON.stringify(request));
}

// Something new begins: what was said of the last is over.
function begin() {
  $("answer").textContent = "";
  show();
}

// Which buttons can act now, what is being carried out, and what the loop does.
function show() {
  for (const button of document.querySelectorAll("[data-do]")) {
    button.title = unable(button.dataset.do);
    button.setAttribute("aria-disabled", String(Boolean(button.title)));
    button.setAttribute("aria-busy", String(running.has(button.dataset.do)));
  }
  $("running").textContent = [...running].map(([what, since]) => {
    const button = document.querySelector(`[data-do=${what}]`);
    return `${button ? button.textContent : what}: ${((performance.now() - since) / 1e3).toFixed(0)} s`;
  }).join("\n");
  words();
}
setInterval(() => { if (running.size) show(); }, 1000);

function say(answer) {
  if (answer.done && !answer.text) return;
  $("answer").textContent = answer.text;
  $("answer").classList.toggle("refused", !answer.done);
}

// -- what comes --------------------------------------------------------------------------

function connect() {
  socket = new WebSocket(`ws://${location.host}/live?token=${encodeURIComponent(token)}`);
  socket.binaryType = "arraybuffer";
  let opened = false;
  socket.onopen = () => { opened = true; refused = 0; link("connected", true); trouble(sceneless); show(); };
  socket.onmessage = (event) => {
    const message = typeof event.data === "string" ? JSON.parse(event.data) : null;
    try {
      if (window.arasPage.still) return;
      if (message === null) picture(event.data);
      else hear(message);
    } finally {
      if (message === null || message.kind !== "answer") event.target.send("seen");  // the next
    }
  };
  socket.onclose = async () => {
    link("no connection", false);
    running.clear();  // their answers come no more
    show();
    if (!opened) {
      try {  // a refusal is said in words, a simulator that is gone says nothing
        const reply = await fetch(`/robot?token=${encodeURIComponent(token)}`);
        if (reply.status === 403) { trouble(await reply.text()); return; }
        refused += 1;
        if (refused > 2) trouble("The simulator is there and takes no more pages: close one that is open.");
      } catch { refused = 0; /* not there (yet) */ }
    }
    setTimeout(connect, 1000);
  };
}

function link(text, on) {
  $("link").textContent = text;
  $("link").className = `badge ${on ? "on" : "off"}`;
}

function hear(message) {
  if (message.kind === "answer") {
    if (message.do) running.delete(message.do);
    else running.clear();  // of which one is not known: what is not sent again does no harm
    say(message);
    show();
    return;
  }
  const whole = message.kind === "whole";
  if (whole) { state.samples = []; robotOf = null; }
  if (message.limits) limits(message.limits);
  if (message.choices) choices(message.choices);
  if (message.state) values(message.state);
  if (message.told) { state.told = message.told; plots[0].units = message.told.units || []; }
  if (message.names) state.names = plots[0].names = message.names;
  if (message.samples) samples(message.samples);
  if (scene && (message.shapes || whole)) scene.setShapes(message.shapes || {}, whole);
  if (message.joints) joints(message.joints, message.speeds);
  if ("factor" in message) $("factor").textContent = message.factor === null ? "–" : message.factor.toFixed(2);
  if (message.told || message.state || message.choices || message.limits) show();
  if ("stamp" in message) $("time").textContent = message.stamp.toFixed(2);
}

function samples(rows) {
  for (const row of rows) {
    if (row[0] === "clear") { state.samples = []; continue; }
    const last = state.samples.length ? state.samples[state.samples.length - 1][0] : -Infinity;
    if (row[0] > last) state.samples.push(row);
    else if (row[0] < last - 1) state.samples = [row];
  }
  if (state.samples.length > KEPT) state.samples.splice(0, state.samples.length - KEPT);
  dirty = true;
}

function words() {
  const told = state.told;
  $("phase").textContent = told.phase || "waiting";
  $("phase").className = `badge ${told.phase || "waiting"}`;
  $("scheme").textContent = told.scheme || "";
  const outcome = told.outcome && !["running", told.phase].includes(told.outcome) ? told.outcome.replace(/_/g, " ") : "";
  const idle = running.has("servo") || running.has("goal") ? "the nodes are being started"
    : loop() || "the controller runs and has told of no image yet";
  const text = told.phase ? [outcome, told.reason].filter(Boolean).join(": ") : idle;
  $("words").textContent = told.remedy && outcome ? `${text} — ${told.remedy}` : text;
  $("words").title = $("words").textContent;
}

async function robot(of) {
  if (!of || robotOf === of || !scene) return;  // there is none yet
  robotOf = of;
  const reply = await fetch(`/robot?token=${encodeURIComponent(token)}`);
  if (reply.ok) { scene.setRobot(await reply.json()); scene.setJoints(positions); }
  else robotOf = null;  // gone meanwhile; another will be told
}

function limits(given) {
  state.limits = given;
  const box = $("joints");
  box.textContent = "";
  (given.names || []).forEach((name) => {
    const row = document.createElement("div");
    row.className = "joint";
    const label = document.createElement("span"), bar = document.createElement("div");
    const mark = document.createElement("i"), output = document.createElement("output");
    label.textContent = label.title = name;
    bar.className = "bar";
    bar.append(mark);
    row.append(label, bar, output);
    box.append(row);
  });
  jogJoints(given.names || []);
}

function joints(values, speeds) {
  const { names = [], lower = [], upper = [], prismatic = [] } = state.limits;
  positions = Object.fromEntries(names.map((name, i) => [name, values[i]]));
  if (scene) scene.setJoints(positions);
  [...$("joints").children].forEach((row, i) => {
    const value = values[i], low = lower[i], high = upper[i];
    if (value === null || value === undefined) return;
    const bounded = low !== null && high !== null;
    const part = bounded ? (value - low) / (high - low) : 0.5 + Math.atan(value / 3) / Math.PI;
    row.querySelector("i").style.left = `${100 * Math.min(1, Math.max(0, part))}%`;
    row.classList.toggle("near", bounded && (part < 0.1 || part > 0.9));
    row.classList.toggle("at", bounded && (part < 0.01 || part > 0.99));
    const speed = speeds && speeds[i] !== null ? speeds[i] : 0;
    row.querySelector("output").textContent = prismatic[i]
      ? `${value.toFixed(3)} m` : `${(value * 180 / Math.PI).toFixed(1)}°`;
    row.title = `${value.toFixed(4)} ${prismatic[i] ? "m" : "rad"}, ${speed.toFixed(3)}/s`
      + (bounded ? `, limits ${low.toFixed(3)} to ${high.toFixed(3)}` : ", no limits");
  });
}

let decoding = false;
async function picture(bytes) {
  if (decoding || document.hidden) return;
  decoding = true;
  try {
    const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
    const canvas = $("picture");
    if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
      canvas.width = bitmap.width; canvas.height = bitmap.height;
    }
    canvas.getContext("2d").drawImage(bitmap, 0, 0);
  } finally { decoding = false; }
}

// -- what may be chosen ------------------------------------------------------------------

const CHOSEN = ["scheme", "law", "start", "goal", "camera", "target"];
for (const id of CHOSEN) {
  const select = $(`choose-${id}`);
  select.addEventListener("change", () => { select.dataset.own = select.value; });
}

function choices(given) {
  state.choices = given;
  for (const [id, kind, current] of [
    ["scheme", "schemes", "scheme"], ["law", "laws", "law"], ["start", "starts", "start"],
    ["goal", "goals", "goal"], ["camera", "cameras", "camera"], ["target", "targets", "target"],
  ]) {
    const select = $(`choose-${id}`), own = select.dataset.own;
    select.textContent = "";
    for (const name of given[kind] || []) select.add(new Option(name, name));
    const wanted = (given[kind] || []).includes(own) ? own : state.values[current];
    if (wanted) select.value = wanted;
  }
}

function values(given) {
  const before = state.values;
  state.values = given;
  for (const id of CHOSEN) {  // what runs now is shown, until another is chosen here
    const select = $(`choose-${id}`);
    if (!given[id] || given[id] === before[id]) continue;
    delete select.dataset.own;
    select.value = given[id];
  }
  gains(given.gains || {});
  robot(given.robot);
  $("recording").classList.toggle("refused", Boolean(given.trouble));
  $("recording").textContent = given.trouble ? given.trouble : given.recording ? `recording to ${given.recording}`
    : given.recorded ? `recorded: ${given.recorded}` : "";
  $("report-link").hidden = !given.report;
  if (given.report) $("report-link").href = `/report/${given.report}?token=${encodeURIComponent(token)}`;
  $("no-target").textContent = given.no_target || "";
  if (given.picture) $("picture-note").textContent = given.picture;
}

function slider(name, low, high, step, value, changed) {
  const row = document.createElement("div"), label = document.createElement("span");
  const input = document.createElement("input"), output = document.createElement("output");
  row.className = "slider";
  label.textContent = name;
  Object.assign(input, { type: "range", min: low, max: high, step, value });
  input.setAttribute("aria-label", name);
  const show = () => { output.textContent = changed.show ? changed.show(+input.value) : (+input.value).toFixed(2); };
  input.addEventListener("input", show);
  input.addEventListener("change", () => changed.set && changed.set(+input.value));
  row.append(label, input, output);
  row.input = input; row.show = show;
  show();
  return row;
}

// Gains on a logarithmic scale, from a thousandth of their greatest value.
function gains(given) {
  const box = $("gains"), names = Object.keys(given);
  if (box.dataset.names !== names.join()) {
    box.dataset.names = names.join();
    box.textContent = names.length ? "" : "no controller with gains now";
    for (const name of names) {
      const row = slider(name, -2, 2, 0.02, Math.log10(given[name]), {
        set: (v) => ask({ do: "gain", name, value: Math.pow(10, v) }),
        show: (v) => Math.pow(10, v).toPrecision(3),
      });
      row.dataset.gain = name;
      box.append(row);
    }
  }
  for (const row of box.querySelectorAll("[data-gain]")) {
    if (document.activeElement === row.input) continue;
    const gain = given[row.dataset.gain];
    row.input.value = Math.log10(gain);  // to the next of its steps
    row.querySelector("output").textContent = gain.toPrecision(3);
  }
}

const goalRows = {};
for (const [name, reach] of [["x", 0.1], ["y", 0.1], ["z", 0.1], ["turn", 1.5]]) {
  goalRows[name] = slider(name, -reach, reach, reach / 50, 0, {});
  $("goal-sliders").append(goalRows[name]);
}

for (const button of document.querySelectorAll("[data-do]")) {
  const what = button.dataset.do;
  button.addEventListener("click", () => {
    const why = unable(what);
    if (why) say({ done: false, text: why });
    else ask({ do: what, ...(what in FIELDS ? FIELDS[what]() : {}) });
  });
}
$("teach-name").addEventListener("input", show);
$("view-all").addEventListener("click", () => scene && scene.setView("all"));
$("view-run").addEventListener("click", () => scene && scene.setView("run"));

// -- driving by hand ---------------------------------------------------------------------

const AXES = ["vx", "vy", "vz", "wx", "wy", "wz"];
const KEYS = { d: ["vx", 1], a: ["vx", -1], s: ["vy", 1], w: ["vy", -1], r: ["vz", 1], f: ["vz", -1],  // aras_teleop's
  i: ["wx", 1], k: ["wx", -1], o: ["wy", 1], u: ["wy", -1], l: ["wz", 1], j: ["wz", -1] };
const held = new Map();
let jogging = null;

function hold(key, request) {
  held.set(key, request);
  if (!jogging) { begin(); jog(); jogging = setInterval(jog, JOG_PERIOD); }
}

function release(key) {
  if (!held.delete(key) || held.size) return;
  clearInterval(jogging);
  jogging = null;
  ask({ do: "jog" });
}

function jog() {
  const speed = +$("jog-speed").value, twist = {};
  for (const request of held.values()) {
    if (request.joint) { ask({ do: "jog_joint", joint: request.joint, speed: request.sign * speed }); return; }
    twist[request.axis] = request.sign * speed * (request.axis[0] === "v" ? 0.25 : 1);
  }
  ask({ do: "jog", ...twist });
}

function jogButton(text, request) {
  const button = document.createElement("button");
  button.textContent = text;
  button.addEventListener("pointerdown", (e) => {
    button.setPointerCapture(e.pointerId);
    button.classList.add("held");
    hold(button, request);
  });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
    button.addEventListener(end, () => { button.classList.remove("held"); release(button); });
  }
  return button;
}

for (const axis of AXES) {
  for (const sign of [-1, 1]) {
    $("jog-camera").append(jogButton(`${axis.replace("w", "ω")} ${sign < 0 ? "−" : "+"}`, { axis, sign }));
  }
}
function jogJoints(names) {
  $("jog-joints").textContent = "";
  for (const joint of names) {
    for (const sign of [-1, 1]) {
      $("jog-joints").append(jogButton(`${joint} ${sign < 0 ? "−" : "+"}`, { joint, sign }));
    }
  }
}
$("scene").addEventListener("keydown", (e) => {
  const key = KEYS[e.key.toLowerCase()];
  if (!key || e.ctrlKey || e.metaKey || e.altKey) return;
  e.preventDefault();
  hold(e.key.toLowerCase(), { axis: key[0], sign: key[1] });
});
addEventListener("keyup", (e) => release(e.key.toLowerCase()));
addEventListener("blur", () => { for (const key of [...held.keys()]) release(key); });

// -- plots: as often as the eye asks for -----------------------------------------------------

setInterval(() => {
  if (!dirty || document.hidden) return;
  dirty = false;
  for (const plot of plots) plot.draw(state.samples);
}, 120);
new ResizeObserver(() => { for (const plot of plots) plot.draw(state.samples); }).observe($("plots-box"));
// For tests and pictures: what is known, and `still`, which lets nothing change any more.
window.arasPage = { state, still: false, get scene() { return scene; } };
show();
connect();
