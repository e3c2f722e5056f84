// The live page. It shows the messages of the WebSocket, and sends a request for each button.

import { follow } from "./framing.js";
import { showJointButtons, startJogging } from "./jog.js";
import { NEWEST, Plot, TimeRange } from "./plots.js";
import { Scene } from "./scene.js";

const token = new URLSearchParams(location.search).get("token") || "";
const $ = (id) => document.getElementById(id);
const state = { limits: {}, choices: {}, values: {}, names: [], samples: [], controller: {}, factor: null };
let socket = null, scene = null, loadedRobot = null, dirty = true, positions = {};
let sceneError = "";   // reason why the scene cannot be drawn
let refusalCount = 0;  // number of successive refused connections

try {
  scene = new Scene($("scene"));
  follow(scene, "run");
} catch (error) {
  sceneError = String(error.message || error);
  showError(sceneError);
}
const timeRange = new TimeRange(() => { dirty = true; });
const plots = [
  new Plot($("plot-error"), timeRange, (s) => s[1]),
  new Plot($("plot-velocity"), timeRange, (s) => s[2].slice(0, 3), (s) => s[3].slice(0, 3)),
  new Plot($("plot-turn"), timeRange, (s) => s[2].slice(3), (s) => s[3].slice(3)),
];
plots[1].names = ["vx", "vy", "vz"];
plots[2].names = ["ωx", "ωy", "ωz"];

function showError(text) {
  $("error").textContent = text;
  $("error").hidden = !text;
}

const running = new Map();  // start time (ms) of each request in progress
const NO_CONNECTION = "no connection to the simulator", NO_CONTROLLER = "no controller is running: start the nodes with a scheme";
const controllerReason = () => state.values.controller ? "" : state.values.missing || NO_CONTROLLER;
// For some requests, a function that returns why the request is not possible now, or "" if it is. All other requests
// are always possible.
const DISABLED_REASONS = {
  start: controllerReason, stop: controllerReason, hold: controllerReason,
  goal: () => (state.limits.names || []).length ? "" : "there is no robot yet",
  target: () => state.values.no_target ? `${state.values.no_target}: there is no target to replace` :
    (state.choices.targets || []).length ? "" : "there are no targets to choose from",
  teach: () => $("teach-name").value ? "" : "give the goal a name first",
  record: () => state.values.open_bag && !state.values.recording_error ? "a bag is already being recorded" : "",
  stop_record: () => state.values.open_bag ? "" : "nothing is being recorded",
  report: () => state.values.open_bag ? "a bag is being recorded: stop the recording first"
    : state.values.last_bag ? "" : "nothing has been recorded yet",
};
// For each request with fields, a function that returns their values.
const REQUEST_FIELDS = {
  step: () => ({ steps: +$("steps").value }),
  servo: () => ({ scheme: $("choose-scheme").value, law: $("choose-law").value,
    start: $("choose-start").value, goal: $("choose-goal").value }),
  goal: () => Object.fromEntries(Object.entries(goalRows).map(([k, row]) => [k, +row.input.value])),
  camera: () => ({ preset: $("choose-camera").value }),
  target: () => ({ name: $("choose-target").value }),
  teach: () => ({ name: $("teach-name").value }),
};

function connected() { return socket !== null && socket.readyState === WebSocket.OPEN; }

function disabledReason(what) {
  if (!connected()) return NO_CONNECTION;
  if (running.has(what)) return "this request is in progress";
  return what in DISABLED_REASONS ? DISABLED_REASONS[what]() : "";
}

function sendRequest(request) {
  if (!connected()) { showAnswer({ ok: false, text: NO_CONNECTION }); return; }
  if (!request.do.startsWith("jog")) {  // jog requests are sent ten times a second
    running.set(request.do, performance.now());
    startRequest();
  }
  socket.send(JSON.stringify(request));
}

// Clear the answer to the previous request when a new one starts.
function startRequest() {
  $("answer").textContent = "";
  updateButtons();
}

// Enable or disable the buttons; list the requests in progress and the controller's state.
function updateButtons() {
  for (const button of document.querySelectorAll("[data-do]")) {
    button.title = disabledReason(button.dataset.do);
    button.setAttribute("aria-disabled", String(Boolean(button.title)));
    button.setAttribute("aria-busy", String(running.has(button.dataset.do)));
  }
  $("running").textContent = [...running].map(([what, since]) => {
    const button = document.querySelector(`[data-do=${what}]`);
    return `${button ? button.textContent : what}: ${((performance.now() - since) / 1e3).toFixed(0)} s`;
  }).join("\n");
  showController();
}
setInterval(() => { if (running.size) updateButtons(); }, 1000);

function showAnswer(answer) {
  if (answer.ok && !answer.text) return;
  $("answer").textContent = answer.text;
  $("answer").classList.toggle("refused", !answer.ok);
}

function connect() {
  socket = new WebSocket(`ws://${location.host}/live?token=${encodeURIComponent(token)}`);
  socket.binaryType = "arraybuffer";
  let opened = false;
  socket.onopen = () => { opened = true; refusalCount = 0; showConnection("connected", true); showError(sceneError); updateButtons(); };
  socket.onmessage = (event) => {
    const message = typeof event.data === "string" ? JSON.parse(event.data) : null;
    try {
      if (window.arasPage.isFrozen) return;
      if (message === null) showImage(event.data);
      else handleMessage(message);
    } finally {
      if (message === null || message.kind !== "answer") event.target.send("ack");  // the server may send the next message
    }
  };
  socket.onclose = async () => {
    showConnection("no connection", false);
    running.clear();  // no answers arrive after the connection has ended
    updateButtons();
    if (!opened) {
      try {  // the server sends the reason of a refusal; if no simulator is running, fetch fails
        const reply = await fetch(`/robot?token=${encodeURIComponent(token)}`);
        if (reply.status === 403) { showError(await reply.text()); return; }
        refusalCount += 1;
        if (refusalCount > 2) showError("The simulator accepts no more pages: close another page.");
      } catch { refusalCount = 0; /* no simulator is running */ }
    }
    setTimeout(connect, 1000);
  };
}

function showConnection(text, on) {
  $("link").textContent = text;
  $("link").className = `state ${on ? "on" : "off"}`;
  showMissing();
}

// Say what the page lacks, and why.
function showMissing() {
  const missing = connected() ? state.values.missing || "" : `There is ${NO_CONNECTION}: it has ended, or the network is interrupted. `
    + "The page shows the last values, and connects again when the simulator answers. A simulator that was started again prints a new address.";
  $("missing").textContent = missing;
  $("missing").hidden = !missing;
}

function handleMessage(message) {
  if (message.kind === "answer") {
    if (message.do) running.delete(message.do);
    else running.clear();  // the answer does not contain the name of its request
    showAnswer(message);
    updateButtons();
    return;
  }
  const isFull = message.kind === "full";
  if (isFull) { state.samples = []; loadedRobot = null; }
  if (message.limits) showLimits(message.limits);
  if (message.choices) showChoices(message.choices);
  if (message.state) showState(message.state);
  if (message.controller) setController(message.controller);
  if (message.names) state.names = plots[0].names = message.names;
  if (message.samples) addSamples(message.samples);
  if (scene && (message.shapes || isFull)) scene.setShapes(message.shapes || {}, isFull);
  if (message.joints) showJoints(message.joints, message.velocities);
  if ("real_time_factor" in message) $("factor").textContent = message.real_time_factor === null ? "–" : message.real_time_factor.toFixed(2);
  if (message.controller || message.state || message.choices || message.limits) updateButtons();
  if ("stamp" in message) $("time").textContent = message.stamp.toFixed(2);
}

function addSamples(rows) {
  for (const row of rows) {
    if (row[0] === "clear") { state.samples = []; continue; }
    const last = state.samples.length ? state.samples[state.samples.length - 1][0] : -Infinity;
    if (row[0] > last) state.samples.push(row);  // earlier rows were in the full message, too
  }
  dirty = true;
}

function setController(controller) {
  const { units = [], tolerances = [], twist_tolerances: [velocity, turn] = [] } = controller;
  state.controller = controller;
  Object.assign(plots[0], { units, tolerances });
  plots[1].tolerances = [velocity, velocity, velocity];
  plots[2].tolerances = [turn, turn, turn];
}

function showController() {
  const { scheme, phase, outcome: result, reason, remedy } = state.controller;
  $("phase").textContent = phase || "waiting";
  $("phase").className = `state ${phase || "waiting"}`;
  $("scheme").textContent = scheme || "";
  const outcome = result && !["running", phase].includes(result) ? result.replace(/_/g, " ") : "";
  const idle = running.has("servo") || running.has("goal") ? "the nodes are being started"
    : state.values.missing ? "" : controllerReason() || "the controller is running and has not processed an image yet";
  const isNamed = reason?.startsWith(outcome);  // such as "no joint states on /robot/joint_states"
  const text = phase ? [isNamed ? "" : outcome, reason].filter(Boolean).join(": ") : idle;
  $("controller-message").textContent = remedy && outcome ? `${text} — ${remedy}` : text;
}

async function loadRobot(number) {
  if (!number || loadedRobot === number || !scene) return;
  loadedRobot = number;
  const reply = await fetch(`/robot?token=${encodeURIComponent(token)}`);
  if (reply.ok) { scene.setRobot(await reply.json()); scene.setJoints(positions); }
  else loadedRobot = null;  // the robot was removed; a message will arrive when there is another
}

function showLimits(given) {
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
  showJointButtons(given.names || []);
}

function showJoints(values, velocities) {
  const { names = [], lower = [], upper = [], prismatic = [] } = state.limits;
  positions = Object.fromEntries(names.map((name, i) => [name, values[i]]));
  if (scene) scene.setJoints(positions);
  [...$("joints").children].forEach((row, i) => {
    const value = values[i], low = lower[i], high = upper[i];
    if (value === null || value === undefined) return;
    const bounded = low !== null && high !== null;
    const part = bounded ? (value - low) / (high - low) : 0.5 + Math.atan(value / 3) / Math.PI;
    row.querySelector("i").style.left = `${100 * Math.min(1, Math.max(0, part))}%`;
    row.classList.toggle("near-limit", bounded && (part < 0.1 || part > 0.9));
    row.classList.toggle("at-limit", bounded && (part < 0.01 || part > 0.99));
    const velocity = velocities && velocities[i] !== null ? velocities[i] : 0;
    const unit = prismatic[i] ? "m" : "rad";
    row.querySelector("output").textContent = prismatic[i]
      ? `${value.toFixed(3)} m` : `${(value * 180 / Math.PI).toFixed(1)}°`;
    row.title = `${value.toFixed(4)} ${unit}, ${velocity.toFixed(3)} ${unit}/s`
      + (bounded ? `, limits ${low.toFixed(3)} to ${high.toFixed(3)}` : ", no limits");
  });
}

let decoding = false;
async function showImage(bytes) {
  if (decoding || document.hidden) return;
  decoding = true;
  try {
    const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
    const canvas = $("image");
    if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) {
      canvas.width = bitmap.width; canvas.height = bitmap.height;
    }
    canvas.getContext("2d").drawImage(bitmap, 0, 0);
  } finally { decoding = false; }
}

const CHOICE_IDS = ["scheme", "law", "start", "goal", "camera", "target"];
for (const id of CHOICE_IDS) {
  const select = $(`choose-${id}`);
  select.addEventListener("change", () => { select.dataset.own = select.value; });
}

function showChoices(given) {
  state.choices = given;
  for (const [id, kind, current] of [
    ["scheme", "schemes", "scheme"], ["law", "laws", "law"], ["start", "starts", "start"],
    ["goal", "goals", "goal"], ["camera", "cameras", "camera"], ["target", "targets", "target"],
  ]) {
    const select = $(`choose-${id}`), own = select.dataset.own;
    select.textContent = "";
    for (const name of given[kind] || []) select.add(new Option(name, name));
    const selected = (given[kind] || []).includes(own) ? own : state.values[current];
    if (selected) select.value = selected;
  }
}

function showState(given) {
  const before = state.values;
  state.values = given;
  for (const id of CHOICE_IDS) {  // a new current value replaces the user's selection
    const select = $(`choose-${id}`);
    if (!given[id] || given[id] === before[id]) continue;
    delete select.dataset.own;
    select.value = given[id];
  }
  showGains(given.gains || {});
  loadRobot(given.robot);
  $("recording").classList.toggle("refused", Boolean(given.recording_error));
  $("recording").textContent = given.recording_error ? given.recording_error : given.open_bag ? `recording to ${given.open_bag}`
    : given.last_bag ? `recorded: ${given.last_bag}` : "";
  $("report-link").hidden = !given.report;
  if (given.report) $("report-link").href = `/report/${given.report}?token=${encodeURIComponent(token)}`;
  $("no-target").textContent = given.no_target || "";
  showMissing();
  if (given.image_note) $("image-note").textContent = given.image_note;
}

// Make a row with a name, a slider and its value. `handlers.set` applies a value, `handlers.show` formats it.
function slider(name, low, high, step, value, handlers) {
  const row = document.createElement("div"), label = document.createElement("span");
  const input = document.createElement("input"), output = document.createElement("output");
  row.className = "slider";
  label.textContent = name;
  Object.assign(input, { type: "range", min: low, max: high, step, value });
  input.setAttribute("aria-label", name);
  const show = () => { output.textContent = handlers.show ? handlers.show(+input.value) : (+input.value).toFixed(2); };
  input.addEventListener("input", show);
  input.addEventListener("change", () => handlers.set && handlers.set(+input.value));
  row.append(label, input, output);
  row.input = input; row.show = show;
  show();
  return row;
}

// Show a slider for each gain, with a logarithmic scale from 0.01 to 100.
function showGains(given) {
  const box = $("gains"), names = Object.keys(given);
  if (box.dataset.names !== names.join()) {
    box.dataset.names = names.join();
    box.textContent = names.length ? "" : "no controller with gains is running";
    for (const name of names) {
      const row = slider(name, -2, 2, 0.02, Math.log10(given[name]), {
        set: (v) => sendRequest({ do: "gain", name, value: Math.pow(10, v) }),
        show: (v) => Math.pow(10, v).toPrecision(3),
      });
      row.dataset.gain = name;
      box.append(row);
    }
  }
  for (const row of box.querySelectorAll("[data-gain]")) {
    if (document.activeElement === row.input) continue;
    const gain = given[row.dataset.gain];
    row.input.value = Math.log10(gain);  // the slider rounds this value, so the text below shows the exact gain
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
    const why = disabledReason(what);
    if (why) showAnswer({ ok: false, text: why });
    else sendRequest({ do: what, ...(what in REQUEST_FIELDS ? REQUEST_FIELDS[what]() : {}) });
  });
}
$("teach-name").addEventListener("input", updateButtons);
for (const what of ["all", "run"]) $(`view-${what}`).addEventListener("click", () => scene && follow(scene, what));
startJogging({ startRequest, sendRequest });

$("show-newest").textContent = `Follow the newest ${NEWEST} s`;
for (const part of ["whole", "newest"]) $(`show-${part}`).addEventListener("click", () => timeRange.show(part));

function drawPlots() {
  for (const plot of plots) plot.draw(state.samples);
  for (const part of ["whole", "newest"]) $(`show-${part}`).setAttribute("aria-pressed", String(timeRange.part === part));
  const [first, last] = plots[0].range;
  $("shown-part").textContent = timeRange.part === "selected" ? `${first.toFixed(2)} s to ${last.toFixed(2)} s` : "";
  $("no-samples").hidden = state.samples.length > 0;
}

setInterval(() => {
  if (!dirty || document.hidden) return;
  dirty = false;
  drawPlots();
}, 120);
new ResizeObserver(drawPlots).observe($("plots-box"));
document.addEventListener("themechange", () => { for (const plot of plots) plot.restyle(state.samples); });
// For tests and screenshots; `isFrozen` discards all further messages.
window.arasPage = { state, plots, timeRange, isFrozen: false, get scene() { return scene; } };
updateButtons();
connect();
