// The results browser: what is chosen is one object; each part of the page asks and draws for itself.

import { Points, drawMap, headed, make, word } from "./views.js";

const $ = (id) => document.getElementById(id);
const token = new URLSearchParams(location.search).get("token") || "";
const EVERY = 3000;  // ms between two looks at the studies
const ROWS = 50;

/** What is chosen; kept in the address, so that a view can be gone back to and handed on. */
const view = { off: [], filters: [], sort: "", descending: false, first: 0, map: {}, plot: {}, by: [], medians: [], hidden: null, run: null, ...kept() };
const page = { studies: [], columns: [], version: -1, names: [], rows: [], answered: 0 };

function kept() {
  try { return JSON.parse(decodeURIComponent(location.hash.slice(1))) || {}; } catch { return {}; }
}

async function ask(question) {
  let answer;
  try {
    const got = await fetch(`/ask?token=${encodeURIComponent(token)}`, { method: "POST", body: JSON.stringify(question) });
    answer = got.headers.get("Content-Type").startsWith("application/json") ? await got.json() : { error: await got.text() };
  } catch {
    answer = { error: "no connection: the browser's program has ended; start it again" };
  }
  if (answer.error) throw new Error(answer.error);
  return answer;
}

function trouble(text) {
  $("trouble").hidden = !text;
  $("trouble").textContent = text;
}

const column = (name) => page.columns.find((c) => c.name === name) || { name, unit: "", kind: "word", values: [], role: "" };
const label = (name) => headed(name, column(name).unit);
const asked = () => ({ studies: view.off.length ? page.studies.map((s) => s.name).filter((name) => !view.off.includes(name)) : [],
  filters: view.filters.map(([column, operator, value]) => ({ column, operator, value })) });

// -- studies and columns ----------------------------------------------------------------------------

async function look(now = false) {
  let answer;
  try { answer = await ask({ do: "studies", now }); } catch (error) { trouble(error.message); return; }
  trouble([answer.note, ...answer.studies.map((s) => s.note && `${s.name}: ${s.note}`)].filter(Boolean).join("; "));
  if (answer.version === page.version) return;
  const before = page.columns.map((c) => c.name).join();
  Object.assign(page, { version: answer.version, studies: answer.studies, columns: answer.columns, operators: answer.operators });
  view.off = view.off.filter((name) => page.studies.some((s) => s.name === name));
  showStudies();
  if (page.columns.map((c) => c.name).join() !== before) offer();
  refresh();
  if (view.run && $("run").hidden) open(...view.run);  // as the address says
}

function showStudies() {
  $("studies").textContent = "";
  for (const study of page.studies) {
    const button = make("button", "", "chip"), off = view.off.includes(study.name);
    button.append(make("span", study.name), make("small", study.runs < study.of ? `${study.runs} of ${study.of}` : `${study.runs}`));
    button.title = study.note || study.path;
    button.setAttribute("aria-pressed", String(!off));
    button.addEventListener("click", () => {
      const on = page.studies.map((s) => s.name).filter((name) => !view.off.includes(name));
      if (!off && on.length === 1) return;  // one stays
      view.off = off ? view.off.filter((name) => name !== study.name) : [...view.off, study.name];
      showStudies();
      chosen();
    });
    $("studies").append(button);
  }
  $("compare").hidden = page.studies.length < 2;
}

/** Columns to choose from, everywhere. */
function offer() {
  const several = page.studies.length > 1, settings = page.columns.filter((c) => c.role === "setting");
  const metrics = page.columns.filter((c) => c.role === "metric" && c.name !== "success");
  const all = [...settings, ...page.columns.filter((c) => c.role !== "setting")].map((c) => c.name);
  const names = all.filter((name) => column(name).kind === "number");
  const most = 0.5 * Math.max(...settings.map((c) => c.known)), rank = (c) => 2 * (c.known >= most) + (c.values.length > 0);
  const varied = settings.filter((c) => c.count > 1).sort((a, b) => rank(b) - rank(a)).map((c) => c.name);
  const has = (name) => page.columns.some((c) => c.name === name && (c.kind === "word" || c.count > 1));
  const first = (...wanted) => wanted.find((name) => name && has(name)) || all[0];
  const start = {
    column: first(...varied, "study"), "map-value": "success", "map-x": first(varied[1], varied[0], several && "study", "end"), "map-y": first(varied[0], "end"),
    "plot-x": first(varied[0], "run"), "plot-y": first("final_distance", "settled", metrics[0] && metrics[0].name), "plot-shade": "success",
    "by-0": several ? "study" : first(varied[0]), "by-1": several ? varied[0] || "" : varied[1] || "",
    "median-0": has("settled") ? "settled" : "", "median-1": has("final_distance") ? "final_distance" : "",
  };
  const lists = {
    column: all, "map-value": ["success", ...metrics.map((c) => c.name)], "map-x": all, "map-y": all, "plot-x": all, "plot-y": all, "plot-shade": ["", ...all],
    "by-0": ["", ...all], "by-1": ["", ...all], "median-0": ["", ...names], "median-1": ["", ...names],
  };
  for (const [id, list] of Object.entries(lists)) {
    const held = choice(id);
    $(id).textContent = "";
    for (const name of list) $(id).append(new Option(name ? label(name) : "–", name));
    $(id).value = held !== undefined && list.includes(held) ? held : start[id];
    keep(id);
  }
  $("operator").textContent = "";
  for (const one of page.operators) $("operator").append(new Option(one, one));
  values();
  if (!view.hidden) {
    const shown = ["run", ...varied, ...(several ? ["study"] : []), "end", "settled", "final_distance", "reason"];
    view.hidden = page.columns.map((c) => c.name).filter((name) => !shown.includes(name));
  }
  $("columns").querySelectorAll("label").forEach((old) => old.remove());
  for (const { name } of page.columns) {
    const box = make("input"), line = make("label");
    box.type = "checkbox";
    box.checked = !view.hidden.includes(name);
    box.addEventListener("change", () => {
      view.hidden = box.checked ? view.hidden.filter((n) => n !== name) : [...view.hidden, name];
      address();
      showRows();
    });
    line.append(box, ` ${name}`);
    $("columns").append(line);
  }
  for (const [id, at] of [["first", 0], ["second", 1]]) {
    $(id).textContent = "";
    for (const study of page.studies) $(id).append(new Option(study.name, study.name));
    $(id).selectedIndex = Math.min(at, page.studies.length - 1);
  }
}

const PLACES = { by: "by", median: "medians", map: "map", plot: "plot" };
function choice(id) { const [part, key] = id.split("-"); return part in PLACES ? view[PLACES[part]][key] : undefined; }
function keep(id) { const [part, key] = id.split("-"); if (part in PLACES) view[PLACES[part]][key] = $(id).value; }

function values() {
  const { values, kind, unit } = column($("column").value);
  $("values").textContent = "";
  for (const value of values) $("values").append(new Option(String(value)));
  $("value").placeholder = kind === "word" ? "text" : unit || "number";
}

// -- what is chosen -----------------------------------------------------------------------------------

function chosen() {
  view.first = 0;
  refresh();
}

function address() { history.replaceState(null, "", `#${encodeURIComponent(JSON.stringify(view))}`); }

function limit(filters) {
  const same = (a, b) => a[0] === b[0] && a[1] === b[1];
  view.filters = [...view.filters.filter((old) => !filters.some((one) => same(one, old) && one[1] !== "≠")), ...filters];
  chosen();
}

function showFilters() {
  $("filters").textContent = "";
  view.filters.forEach((filter, i) => {
    const [name, operator, value] = filter, button = make("button", "", "chip");
    const text = operator.startsWith("is") ? `${name} ${operator}` : `${name} ${operator} ${word(value)} ${column(name).unit}`;
    button.append(make("span", text.trim()), make("b", "×"));
    button.setAttribute("aria-label", `remove the filter ${text}`);
    button.addEventListener("click", () => { view.filters.splice(i, 1); chosen(); });
    $("filters").append(button);
  });
  if (view.filters.length > 1) {
    const all = make("button", "Remove all");
    all.addEventListener("click", () => { view.filters = []; chosen(); });
    $("filters").append(all);
  }
}

/** Ask for all that is shown; an answer that is overtaken by another choice is dropped. */
async function refresh() {
  address();
  showFilters();
  const mine = ++page.answered;
  if (!page.columns.length) { $("counted").textContent = "no runs yet: they appear here as soon as a study keeps some"; return; }
  const parts = [[rowsQuestion(), tookRows], [{ do: "map", ...asked(), ...view.map }, tookMap],
    [{ do: "points", ...asked(), ...view.plot }, tookPoints],
    [{ do: "groups", ...asked(), by: [...new Set(view.by)].filter(Boolean), values: [...new Set(view.medians)].filter(Boolean) }, tookGroups]];
  document.body.setAttribute("aria-busy", "true");
  await Promise.all(parts.map(async ([question, took]) => {
    try {
      const answer = await ask(question);
      if (mine === page.answered) took(answer, question);
    } catch (error) { if (mine === page.answered) trouble(error.message); }
  }));
  if (mine === page.answered) document.body.removeAttribute("aria-busy");
}

const rowsQuestion = () => ({ do: "rows", ...asked(), sort: page.columns.some((c) => c.name === view.sort) ? view.sort : "", descending: view.descending, first: view.first, count: ROWS });

// -- map, points, groups ------------------------------------------------------------------------------

function tookMap(answer, { x, y, value }) {
  drawMap($("cells"), $("scale"), answer, { x: column(x), y: column(y), value, unit: column(value).unit, isRate: value === "success" }, limit);
}

let colours = {};
const colour = (name) => colours[name] ||= getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const points = new Points($("points"), colour, {
  pointed: (at) => {
    $("pointed").textContent = at === null ? " " : `${at.study}, run ${at.run}: ${view.plot.x} ${word(at.x)}, ${view.plot.y} ${word(at.y)}`;
  },
  pressed: (at) => open(at.study, at.run),
  boxed: (xs, ys) => {
    const range = (name, [low, high]) => column(name).kind === "number" ? [[name, "≥", low], [name, "≤", high]] : [];
    limit([...range(view.plot.x, xs), ...range(view.plot.y, ys)]);
  },
});

function tookPoints(answer, { x, y, shade }) {
  points.success = shade === "success";
  points.show(answer, column(x), column(y));
  $("classes").textContent = "";
  if (shade) $("classes").append(label(shade));
  answer.classes.forEach((value, k) => {
    const mark = make("i");
    mark.style.setProperty("--shade", points.shadeOf(k));
    $("classes").append(mark, shade === "success" ? (value ? "success" : "no success") : word(value));
  });
  $("pointed").textContent = answer.left ? `${answer.left} runs have no such values` : " ";
}

const percent = (v) => v === null ? "–" : `${(100 * v).toFixed(v > 0 && v < 0.1 || v > 0.9 && v < 1 ? 1 : 0)}`;

function tookGroups(answer, { by, values }) {
  const table = $("grouped");
  table.textContent = "";
  const head = table.createTHead().insertRow();
  const heading = (text, number) => { const cell = make("th", text, number ? "number" : ""); cell.scope = "col"; head.append(cell); };
  by.forEach((name) => heading(label(name), column(name).kind === "number"));
  heading("runs", true); heading("success (%)", true); heading("95 % interval", true);
  values.forEach((name) => heading(label(name), true));
  heading("commonest other end");
  const body = table.createTBody();
  for (const group of answer.groups) {
    const row = body.insertRow(), cells = group.values.map((v, i) => [word(v), column(by[i]).kind === "number"]);
    const [rate, low, high] = group.rate;
    cells.push([group.runs, true], [percent(rate), true], [`${percent(low)} – ${percent(high)}`, true],
      ...group.medians.map((v) => [word(v), true]), [group.failure, false]);
    cells.forEach(([text, number], i) => {
      const cell = row.insertCell();
      cell.className = number ? "number" : "";
      if (i || !by.length) { cell.textContent = text; return; }
      const button = make("button", text, "plain");
      button.title = "only these runs";
      cell.append(button);
    });
    if (by.length) row.addEventListener("click", () => limit(group.bounds));
  }
  if (answer.count > answer.groups.length) table.append(make("caption", `${answer.groups.length} of ${answer.count} groups`));
}

// -- runs ---------------------------------------------------------------------------------------------

function tookRows(answer) {
  const all = page.studies.filter((s) => !view.off.includes(s.name)).reduce((sum, s) => sum + s.runs, 0);
  const rate = answer.total ? ` ${answer.succeeded} of them (${percent(answer.succeeded / answer.total)} %) succeeded.` : "";
  $("counted").textContent = `${answer.total === all ? "" : `${answer.total} of `}${all} runs of ${page.studies.length - view.off.length} ${page.studies.length - view.off.length === 1 ? "study" : "studies"}.${rate}`;
  page.rows = answer.rows; page.total = answer.total;
  showRows();
}

function showRows() {
  const table = $("rows"), names = page.columns.map((c) => c.name);
  const last = ["reason", "remedy"], first = ["study", "run"], rank = (n) => last.includes(n) ? 5 : first.includes(n) ? 0
    : column(n).role === "setting" ? 1 : n === "end" ? 2 : column(n).role === "metric" ? 3 : 4;
  const order = [...names].sort((a, b) => rank(a) - rank(b));  // else as they are
  const shown = order.filter((name) => !view.hidden.includes(name));
  table.textContent = "";
  const head = table.createTHead().insertRow();
  for (const name of shown) {
    const cell = make("th", "", column(name).kind === "number" ? "number" : ""), button = make("button", label(name), "plain");
    cell.scope = "col";
    cell.setAttribute("aria-sort", view.sort === name ? (view.descending ? "descending" : "ascending") : "none");
    button.addEventListener("click", () => {
      view.descending = view.sort === name && !view.descending;
      view.sort = name;
      chosen();
    });
    cell.append(button);
    head.append(cell);
  }
  const body = table.createTBody(), study = names.indexOf("study"), run = names.indexOf("run"), success = names.indexOf("success");
  for (const values of page.rows) {
    const row = body.insertRow();
    row.dataset.run = values[run];
    for (const name of shown) {
      const value = values[names.indexOf(name)], cell = row.insertCell(), text = word(value);
      cell.className = column(name).kind === "number" ? "number" : "";
      if (name === "run") {
        const button = make("button", text, "plain");
        button.setAttribute("aria-label", `open run ${text} of ${values[study]}`);
        cell.append(button);
      } else if (name === "end") {
        cell.append(make("span", text.replace(/_/g, " "), values[success] === 1 ? "end good-end" : "end bad-end"));
      } else cell.textContent = text;
    }
    row.addEventListener("click", () => open(values[study], values[run]));
  }
  $("place").textContent = page.total ? `${view.first + 1} to ${view.first + page.rows.length} of ${page.total}` : "no runs meet all filters";
  $("less").disabled = view.first === 0;
  $("more").disabled = view.first + page.rows.length >= page.total;
}

// -- one run ------------------------------------------------------------------------------------------

async function open(study, run) {
  const box = $("run");
  let row;
  try { row = (await ask({ do: "run", study, run })).row; } catch (error) { trouble(error.message); return; }
  box.textContent = "";
  const close = make("button", "Close"), title = make("h2", `Run ${run}`), top = make("div", "", "row"), where = make("p", study, "meta");
  top.append(title, make("span", "", "grow"), close);
  close.addEventListener("click", closed);
  const badges = make("p");
  badges.append(make("span", row.outcome || "unknown end", `badge ${/^converged/.test(row.outcome) ? "good" : "bad"}`));
  if (row.verdict) badges.append(make("span", row.verdict, `badge ${row.verdict === "goal_reached" ? "good" : "bad"}`));
  box.append(top, where, badges);
  if (row.success !== 1 && (row.reason || row.remedy)) {
    const why = make("div", "", "why");
    for (const [name, text] of [["Why: ", row.reason], ["Remedy: ", row.remedy]]) {
      if (text) { const line = make("div"); line.append(make("b", name), text); why.append(line); }
    }
    box.append(why);
  }
  const link = make("a", "Open the report", "action");
  link.href = `/run?${new URLSearchParams({ token, study, run })}`;
  link.target = "_blank";
  link.rel = "noopener";
  box.append(link, make("p", "Curves, film and path: computed when it is opened for the first time, which takes some seconds.", "note-below"));
  for (const [role, name] of [["setting", "Settings"], ["metric", "Numbers"], ["run", "The rest"]]) {
    const entries = Object.entries(row).filter(([key]) => column(key).role === role && !["reason", "remedy", "outcome", "verdict", "end", "study", "run"].includes(key));
    if (!entries.length) continue;
    const table = make("table", "", "numbers");
    for (const [key, value] of entries) {
      const line = table.insertRow(), head = make("th", key);
      head.scope = "row";
      line.append(head, make("td", word(value), typeof value === "number" ? "number" : ""), make("td", column(key).unit));
    }
    box.append(make("h3", name), table);
  }
  box.hidden = false;
  box.scrollTop = 0;
  view.run = [study, run];
  address();
  document.body.classList.add("beside");
  close.focus({ preventScroll: true });
}

function closed() {
  $("run").hidden = true;
  view.run = null;
  address();
  document.body.classList.remove("beside");
}

// -- two studies --------------------------------------------------------------------------------------

async function compare() {
  $("compared").textContent = "comparing …";
  $("differences").textContent = "";
  const first = $("first").value, second = $("second").value;
  let answer;
  try { answer = await ask({ do: "compare", first, second }); } catch (error) { $("compared").textContent = error.message; return; }
  const sure = answer.differences.filter((d) => d.verdict !== "chance"), shown = $("chance").checked ? answer.differences : sure;
  $("compared").textContent = `${sure.length} of ${answer.differences.length} comparisons are more than chance (${answer.level} over all).`;
  if (!shown.length) return;
  const table = $("differences"), head = table.createTHead().insertRow(), body = table.createTBody();
  for (const [text, number] of [["settings"], ["quantity"], [first, true], [second, true], ["second is"], ["p", true], ["compared", true]]) {
    const cell = make("th", text, number ? "number" : "");
    cell.scope = "col";
    head.append(cell);
  }
  for (const d of shown.slice(0, 300)) {
    const row = body.insertRow();
    for (const [text, name] of [[d.group], [label(d.metric)], [word(d.before), "number"], [word(d.after), "number"],
      [d.verdict === "chance" ? "as good, up to chance" : d.verdict.toLowerCase(), d.verdict === "chance" ? "" : d.verdict.toLowerCase()],
      [d.p === null ? "–" : d.p.toPrecision(2), "number"], [`${d.count} ${d.paired ? "pairs" : "runs"}`, "number"]]) {
      const cell = row.insertCell();
      cell.textContent = text;
      cell.className = name || "";
    }
  }
}

// -- what is pressed ----------------------------------------------------------------------------------

$("filter").addEventListener("submit", (event) => {
  event.preventDefault();
  const name = $("column").value, operator = $("operator").value, text = $("value").value.trim(), free = operator.startsWith("is");
  const number = column(name).kind === "number" && operator !== "contains";
  if (!free && (text === "" || number && !Number.isFinite(+text))) { trouble(`${name} ${operator} needs a ${number ? "number" : "text"}`); $("value").focus(); return; }
  trouble("");
  $("value").value = "";
  limit([[name, operator, free ? null : number ? +text : text]]);
});
$("column").addEventListener("change", values);
for (const id of ["map-value", "map-x", "map-y", "plot-x", "plot-y", "plot-shade", "by-0", "by-1", "median-0", "median-1"]) {
  $(id).addEventListener("change", () => { keep(id); refresh(); });
}
const turn = (by) => { view.first = Math.max(0, view.first + by); refresh(); };
$("less").addEventListener("click", () => turn(-ROWS));
$("more").addEventListener("click", () => turn(ROWS));
$("pair").addEventListener("submit", (event) => { event.preventDefault(); compare(); });
$("chance").addEventListener("change", () => { if ($("differences").rows.length || $("compared").textContent) compare(); });
addEventListener("keydown", (event) => { if (event.key === "Escape" && view.run) closed(); });

function themed() {
  $("theme").textContent = document.documentElement.dataset.theme === "dark" ? "Light" : "Dark";
  colours = {};
  points.draw();
}
$("theme").addEventListener("click", () => {
  const root = document.documentElement;
  root.dataset.theme = root.dataset.theme === "dark" ? "light" : "dark";
  try { localStorage.setItem("aras-report-theme", root.dataset.theme); } catch { /* nowhere to keep it */ }
  themed();
  refresh();
});
themed();
look(true);
setInterval(() => { if (!document.hidden) look(); }, EVERY);
window.arasBrowser = { page, view, points, limit, look };  // for tests
