// The report page. Plots, films, path and phases have one time cursor. Runs can be hidden, and the time axis can
// be zoomed.

const $ = (id) => document.getElementById(id);
const contents = JSON.parse($("contents").textContent);
const arrays = contents.arrays.map(() => null);
const style = () => getComputedStyle(document.documentElement);
const MIN_RANGE = 1e-3;  // shortest range of the time axis, s
const MAX_KEYS = 8;  // the row of runs at the top has the colours of all runs
const MAX_FILMS = 8;  // of more runs, the films of the first visible ones are shown until the user wants all of them
const MAX_STATES = 4;  // of more visible runs, the page shows how many are in each phase

const page = {
  contents, time: 0, range: [0, contents.transient || contents.end], hiddenRuns: new Set(), overlay: true, several: contents.runs.length > 1,
  dark: contents.colours, goalColour: contents.goal, colours: {},
  array(i) { return arrays[i] ||= new Float32Array(decodeBytes(contents.arrays[i]).buffer); },
  colour(name) { return this.colours[name] ||= style().getPropertyValue(`--${name}`).trim(); },
  setTime(t) {
    t = Math.min(Math.max(t, 0), contents.end);
    if (!Number.isFinite(t) || t === page.time) return;
    page.time = t;
    const [low, high] = page.range;
    if (t < low || t > high) page.showAround(t, high - low);
    requestUpdate();
  },
  setRange(low = 0, high = contents.end) {
    low = Math.max(low, 0); high = Math.min(high, contents.end);
    if (high - low < MIN_RANGE) return;
    page.range = [low, high];
    for (const chart of charts) if (chart.isVisible) chart.setRange(); else chart.isOutdated = true;
    showRange();
    drawPhases();
  },
  /** Show `duration` seconds with t in the middle, or as near to the middle as the ends of the run allow. */
  showAround(t, duration) {
    const half = 0.5 * duration, middle = Math.min(Math.max(t, half), Math.max(contents.end - half, half));
    page.setRange(middle - half, middle + half);
  },
};

const charts = [], films = [];
let space = null, isUpdateRequested = false;

function requestUpdate() {  // at most one update per animation frame
  if (isUpdateRequested) return;
  isUpdateRequested = true;
  requestAnimationFrame(() => { isUpdateRequested = false; showTime(); });
}

/** Show which part of the run is visible; the slider of the time covers the same part. */
function showRange() {
  const [low, high] = page.range, { end, transient } = contents;
  Object.assign($("time"), { min: low, max: high, value: page.time });
  $("shown").textContent = low > 0 || high < end ? `${low.toPrecision(3)} to ${high.toPrecision(3)} s of ${end.toPrecision(3)} s` : "";
  $("zoom-all").setAttribute("aria-pressed", String(low <= 0 && high >= end));
  $("zoom-settling").setAttribute("aria-pressed", String(low <= 0 && high === transient));
}

function showTime() {
  for (const chart of charts) if (chart.isVisible) chart.setTime(page.time);
  films.forEach((film, k) => { if (!film.figure.hidden) film.setTime(page.time); });
  if (space) space.setTime(page.time);
  $("time").value = page.time;
  $("now").textContent = `${page.time.toFixed(3)} s`;
  showPhase();
  drawPhases();
}

/** Show the phase of the controller at the cursor for each visible run. */
function showPhase() {
  const box = $("state");
  box.textContent = "";
  const visible = contents.runs.filter((run, k) => !page.hiddenRuns.has(k) && run.events.length);
  if (visible.length > MAX_STATES) {
    const counts = new Map();
    for (const run of visible) { const [, phase] = eventAt(run, page.time); counts.set(phase, (counts.get(phase) || 0) + 1); }
    box.textContent = [...counts].map(([phase, count]) => `${count} ${count === 1 ? "run" : "runs"} ${phase}`).join(", ");
    return;
  }
  visible.forEach((run) => {
    const [, phase, outcome, reason] = eventAt(run, page.time), line = document.createElement("span");
    const strong = document.createElement("b");
    strong.textContent = page.several ? `${run.name}: ${phase}` : phase;
    const more = [outcome && outcome !== phase && outcome !== "running" ? outcome.replace(/_/g, " ") : "", reason].filter(Boolean);
    line.append(strong, more.length ? ` – ${more.join(": ")}` : "");
    box.append(line);
  });
}

function eventAt(run, t) {
  let low = 0, high = run.events.length;  // by bisection: there may be an event for each image
  while (high - low > 1) { const m = (low + high) >> 1; if (run.events[m][0] <= t + 1e-9) low = m; else high = m; }
  return run.events[low];
}

const PHASE_COLOURS = { converged: "good", servoing: "mark", holding: "warn", stopped: "bad", approaching: "soft" };
function drawPhases() {
  const canvas = $("phases"), width = canvas.clientWidth * (window.devicePixelRatio || 1), c = canvas.getContext("2d");
  canvas.width = Math.max(1, width); canvas.height = 6;
  const [low, high] = page.range, X = (t) => (t - low) / (high - low) * canvas.width;
  const run = contents.runs.find((_, k) => !page.hiddenRuns.has(k));
  if (run) run.phases ||= run.events.filter(([, phase], i) => !i || phase !== run.events[i - 1][1]);
  if (run) run.phases.forEach(([t, phase], i) => {
    const end = i + 1 < run.phases.length ? run.phases[i + 1][0] : contents.end;
    c.fillStyle = page.colour(PHASE_COLOURS[phase] || "soft");
    c.fillRect(X(t), 0, X(end) - X(t), 6);
  });
  c.fillStyle = page.colour("ink");
  c.fillRect(X(page.time) - 1.5, 0, 3, 6);
}

const visibilityObserver = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    const chart = entry.target.chart;
    chart.isVisible = entry.isIntersecting;
    if (!chart.isVisible) continue;
    if (!chart.plot) chart.draw(); else if (chart.isOutdated) chart.setRange(); else chart.resize();
    chart.isOutdated = false;
  }
}, { rootMargin: "200px" });
const sizeObserver = new ResizeObserver((entries) => { for (const { target } of entries) target.chart.resize(); });

for (const group of contents.groups) {
  const box = document.querySelector(`#${CSS.escape(group.key)} .panels`);
  for (const panel of group.panels) {
    const own = document.createElement("div");
    own.className = "panel";
    box.append(own);
    const chart = own.chart = new Chart(own, panel, page);
    chart.plotBox.chart = chart;
    charts.push(chart);
    visibilityObserver.observe(own);
    sizeObserver.observe(chart.plotBox);
  }
}

contents.runs.forEach((run, k) => [run.film, ...run.other_films].forEach((film) => {
  if (!film || !$("films")) return;
  const figure = document.createElement("figure"), canvas = document.createElement("canvas");
  const caption = document.createElement("figcaption");
  canvas.width = film.width; canvas.height = film.height;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `image of the camera ${film.camera || ""} of ${run.name}`);
  figure.append(canvas, caption);
  $("films").append(figure);
  const view = new Film(canvas, caption, run, page, film);
  view.number = k; view.figure = figure;
  films.push(view);
  new ResizeObserver(() => view.setTime(page.time)).observe(canvas);
}));

/** Show the films of the visible runs, and a button for those above MAX_FILMS. */
function showFilms() {
  const visible = films.filter((film) => !page.hiddenRuns.has(film.number)), limit = page.allFilms ? Infinity : MAX_FILMS;
  for (const film of films) film.figure.hidden = true;
  for (const film of visible.slice(0, limit)) film.figure.hidden = false;
  if (!$("more-films")) return;
  $("more-films").hidden = visible.length <= limit;
  $("more-films").textContent = `Show the films of all ${visible.length} visible runs`;
}
if ($("more-films")) $("more-films").addEventListener("click", () => { page.allFilms = true; showFilms(); showTime(); });
showFilms();

/** Add a button with an image for each milestone of the first film. */
async function showMilestones() {
  const film = films[0];
  if (!film) return;
  for (const t of film.film.milestones) {
    const button = document.createElement("button"), canvas = document.createElement("canvas");
    const bitmap = await film.decodeFrame(film.frameIndex(t)), text = document.createElement("span");
    canvas.width = 184; canvas.height = Math.round(184 * bitmap.height / bitmap.width);
    canvas.getContext("2d").drawImage(bitmap, 0, 0, canvas.width, canvas.height);
    text.textContent = `${t.toFixed(2)} s`;
    button.append(canvas, text);
    button.addEventListener("click", () => page.setTime(t));
    $("strip").append(button);
  }
}
showMilestones();

if ($("space")) {
  try {
    space = new Space($("space"), page);
    const fixedEntries = page.several ? [["start, goal, straight paths", contents.ideal]]
      : [["goal", contents.goal], ["start", contents.start], ["straight path", contents.ideal]];
    const entries = [...fixedEntries,
      ...(contents.runs.some((run) => run.poses && run.poses.arm !== undefined) ? [["arm", contents.face]] : []),
      ...contents.runs.slice(0, MAX_KEYS).map((run, k) => [page.several ? run.name : "path", page.dark[k % page.dark.length]])];
    for (const [text, colour] of entries) {
      const mark = document.createElement("i"), entry = document.createElement("span");
      mark.style.setProperty("--shade", colour);
      entry.append(mark, text);  // a line break is before the mark, not after it
      $("key").append(entry, " ");
    }
  } catch (error) {
    $("key").textContent = String(error.message || error);
    $("space").hidden = true;
  }
}

const times = (films[0] && films[0].time) || (charts[0] && charts[0].curves[0].time) || new Float32Array([0]);
$("time").addEventListener("input", () => page.setTime(+$("time").value));
const stepImage = (by) => page.setTime(times[Math.min(Math.max(nearestIndex(times, page.time) + by, 0), times.length - 1)]);
$("previous-image").addEventListener("click", () => stepImage(-1));
$("next-image").addEventListener("click", () => stepImage(1));
$("time").addEventListener("keydown", (e) => {
  const by = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 }[e.key];
  if (by) { e.preventDefault(); stepImage(by); }
});
const zoom = (factor) => page.showAround(page.time, factor * (page.range[1] - page.range[0]));
$("zoom-in").addEventListener("click", () => zoom(0.5));
$("zoom-out").addEventListener("click", () => zoom(2));
$("zoom-all").addEventListener("click", () => page.setRange());
$("zoom-settling").addEventListener("click", () => {
  page.setRange(0, contents.transient);
  page.setTime(Math.min(page.time, contents.transient));
});
if ($("overlay")) $("overlay").addEventListener("change", () => { page.overlay = $("overlay").checked; showTime(); });

let playing = null;
$("play").addEventListener("click", () => {
  if (playing !== null) { stopPlaying(); return; }
  if (page.time >= page.range[1]) page.time = page.range[0];
  let before = performance.now();
  $("play").textContent = "Pause";
  $("play").setAttribute("aria-pressed", "true");
  playing = setInterval(() => {
    const now = performance.now();
    page.setTime(Math.min(page.time + 1e-3 * (now - before), page.range[1]));
    before = now;
    if (page.time >= page.range[1]) stopPlaying();
  }, 33);
});
function stopPlaying() {
  clearInterval(playing);
  playing = null;
  $("play").textContent = "Play";
  $("play").setAttribute("aria-pressed", "false");
}

if (page.several) contents.runs.forEach((run, k) => {
  const button = document.createElement("button"), mark = document.createElement("i"), name = document.createElement("span");
  button.className = "chip";
  button.dataset.run = k;
  mark.style.setProperty("--shade", `var(--curve-${k % 8})`);
  name.textContent = name.title = run.name;
  button.append(mark, name);
  button.setAttribute("aria-pressed", "true");
  button.addEventListener("click", () => {
    if (!page.hiddenRuns.delete(k)) page.hiddenRuns.add(k);
    button.setAttribute("aria-pressed", String(!page.hiddenRuns.has(k)));
    for (const chart of charts) chart._showCurves();
    showFilms();
    for (const cell of document.querySelectorAll(`[data-run="${k}"]:not(button)`)) cell.hidden = page.hiddenRuns.has(k);
    if (space) space.setRuns();
    showTime();
  });
  $("runs").append(button);
});

// Of several runs, the tables of a run become part of the page when they are opened: thousands of rows make it slow.
for (const box of document.querySelectorAll("details")) {
  const later = box.querySelector(":scope > template");
  if (later) box.addEventListener("toggle", () => { later.replaceWith(later.content); addColumnBoxes(box); }, { once: true });
}

/** Add checkboxes that show or hide the columns of the number tables in a part of the page. */
function addColumnBoxes(part) {
  for (const table of part.querySelectorAll("table.columns")) addColumnBox(table);
}
function addColumnBox(table) {
  const set = document.createElement("fieldset"), legend = document.createElement("legend");
  legend.textContent = "Columns";
  set.append(legend);
  [...table.rows[0].cells].forEach((cell, n) => {
    const label = document.createElement("label"), box = document.createElement("input");
    box.type = "checkbox"; box.checked = true;
    box.addEventListener("change", () => { for (const row of table.rows) row.cells[n].hidden = !box.checked; });
    label.append(box, ` ${cell.textContent}`);
    set.append(label);
  });
  table.parentElement.before(set);
}
addColumnBoxes(document);

document.addEventListener("themechange", () => {
  page.colours = {};
  for (const chart of charts) if (chart.plot) chart.draw();
  showTime();
});
showTime();
showRange();
page.setTime(+new URLSearchParams(location.hash.slice(1)).get("at"));  // report.html#at=0.4
window.arasReport = { page, charts, films, get space() { return space; } };  // for tests
