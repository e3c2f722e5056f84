// Jogging: while a button or a key is held, requests move the camera or a joint.

const $ = (id) => document.getElementById(id);
const JOG_PERIOD = 100;  // ms; the robot stops after three periods without a request
const AXES = ["vx", "vy", "vz", "wx", "wy", "wz"];
const KEYS = { d: ["vx", 1], a: ["vx", -1], s: ["vy", 1], w: ["vy", -1], r: ["vz", 1], f: ["vz", -1],  // as in aras_teleop
  i: ["wx", 1], k: ["wx", -1], o: ["wy", 1], u: ["wy", -1], l: ["wz", 1], j: ["wz", -1] };
const pressedKeys = new Map();
let jogging = null;
let page = null;  // functions of the page

function pressKey(key, request) {
  pressedKeys.set(key, request);
  if (!jogging) { page.startRequest(); jog(); jogging = setInterval(jog, JOG_PERIOD); }
}

function releaseKey(key) {
  if (!pressedKeys.delete(key) || pressedKeys.size) return;
  clearInterval(jogging);
  jogging = null;
  page.sendRequest({ do: "jog" });
}

function jog() {
  const speed = +$("jog-speed").value, twist = {};
  for (const request of pressedKeys.values()) {
    if (request.joint) { page.sendRequest({ do: "jog_joint", joint: request.joint, speed: request.sign * speed }); return; }
    twist[request.axis] = request.sign * speed * (request.axis[0] === "v" ? 0.25 : 1);
  }
  page.sendRequest({ do: "jog", ...twist });
}

function makeJogButton(text, request) {
  const button = document.createElement("button");
  button.textContent = text;
  button.addEventListener("pointerdown", (e) => {
    button.setPointerCapture(e.pointerId);
    button.classList.add("pressed-key");
    pressKey(button, request);
  });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
    button.addEventListener(end, () => { button.classList.remove("pressed-key"); releaseKey(button); });
  }
  return button;
}

/** Show the buttons and listen to the keys. `functions`: startRequest() and sendRequest(request) of the page. */
export function startJogging(functions) {
  page = functions;
  for (const axis of AXES) {
    for (const sign of [-1, 1]) {
      $("jog-camera").append(makeJogButton(`${axis.replace("w", "ω")} ${sign < 0 ? "−" : "+"}`, { axis, sign }));
    }
  }
  $("scene").addEventListener("keydown", (e) => {
    const key = KEYS[e.key.toLowerCase()];
    if (!key || e.ctrlKey || e.metaKey || e.altKey) return;
    e.preventDefault();
    pressKey(e.key.toLowerCase(), { axis: key[0], sign: key[1] });
  });
  addEventListener("keyup", (e) => releaseKey(e.key.toLowerCase()));
  addEventListener("blur", () => { for (const key of [...pressedKeys.keys()]) releaseKey(key); });
}

/** Show two buttons for each joint. */
export function showJointButtons(names) {
  $("jog-joints").textContent = "";
  for (const joint of names) {
    for (const sign of [-1, 1]) {
      $("jog-joints").append(makeJogButton(`${joint} ${sign < 0 ? "−" : "+"}`, { joint, sign }));
    }
  }
}
