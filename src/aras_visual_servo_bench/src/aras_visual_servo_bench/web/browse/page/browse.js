// The results browser. The object `view` contains the selection. Each part of the page sends its own query, and
// draws the answer.

import { Points, drawMap, formatHeading, formatValue, make, scaleValues } from "./views.js";

const $ = (id) => document.getElementById(id);
const token = new URLSearchParams(location.search).get("token") || "";
const UPDATE_PERIOD = 3000;  // time between two queries for new studies and runs, ms
const ROWS = 50;  // number of rows on a page of the table of runs

/** The selection. It is stored in the address of the page, so that a view can be reloaded and shared. */
const view = { hidden_studies: [], filters: [], sort: "", descending: false, first: 0, map: {}, plot: {}, by: [], medians: [], hidden_columns: null, run: null, ...readAddress() };
const page = { studies: [], columns: [], version: -1, names: [], rows: [], queryNumber: 0 };

function readAddress() {
  try { return JSON.parse(decodeURIComponent(location.hash.slice(1))) || {}; } catch { return {}; }
}

async function sendQuery(query) {
  let answer;
  try {
    const got = await fetch(`/ask?token=${encodeURIComponent(token)}`, { method: "POST", body: JSON.stringify(query) });
    answer = got.headers.get("Content-Type").startsWith("application/json") ? await got.json() : { error: await got.text() };
  } catch {
    answer = { error: "no connection: the program bench browse has ended; start it again" };
  }
  if (answer.error) throw new Error(answer.error);
  return answer;
}

function showError(text) {
  $("error").hidden = !text;
  $("error").textContent = text;
}

const column = (name) => page.columns.find((c) => c.name === name) || { name, unit: "", size: 1, kind: "word", values: [], role: "" };
const formatIn = (name, value) => formatValue(scaleValues(value, column(name)));  // in the unit of the column
// value of one run: a binary metric is yes or no
const formatInRun = (name, value) => (column(name).is_binary && (value === 0 || value === 1) ? (value ? "yes" : "no") : formatIn(name, value));
// A number in the unit of a column, in the unit of the stored values. 15 digits do not have the rounding error of the product.
const toStored = (name, value) => Number((value * column(name).size).toPrecision(15));
const columnLabel = (name) => formatHeading(name, column(name).unit);
const selection = () => ({ studies: view.hidden_studies.length ? page.studies.map((s) => s.name).filter((name) => !view.hidden_studies.includes(name)) : [],
  filters: view.filters.map(([column, operator, value]) => ({ column, operator, value })) });

async function updateStudies(force = false) {
  let answer;
  try { answer = await sendQuery({ do: "studies", force }); } catch (error) { showError(error.message); return; }
  showError([answer.note, ...answer.studies.map((s) => s.note && `${s.name}: ${s.note}`)].filter(Boolean).join("; "));
  if (answer.version === page.version) return;
  const before = page.columns.map((c) => c.name).join();
  Object.assign(page, { version: answer.version, studies: answer.studies, columns: answer.columns, operators: answer.operators });
  view.hidden_studies = view.hidden_studies.filter((name) => page.studies.some((s) => s.name === name));
  showStudies();
  if (page.columns.map((c) => c.name).join() !== before) fillChoices();
  refresh();
  if (view.run && $("run").hidden) openRun(...view.run);  // this run is part of the page's address
}

function showStudies() {
  $("studies").textContent = "";
  for (const study of page.studies) {
    const button = make("button", "", "chip"), off = view.hidden_studies.includes(study.name);
    button.append(make("span", study.name), make("small", study.runs < study.run_count ? `${study.runs} of ${study.run_count}` : `${study.runs}`));
    button.title = study.note || study.path;
    button.setAttribute("aria-pressed", String(!off));
    button.addEventListener("click", () => {
      const on = page.studies.map((s) => s.name).filter((name) => !view.hidden_studies.includes(name));
      if (!off && on.length === 1) return;  // at least one study remains selected
      view.hidden_studies = off ? view.hidden_studies.filter((name) => name !== study.name) : [...view.hidden_studies, study.name];
      showStudies();
      applySelection();
    });
    $("studies").append(button);
  }
  $("compare").hidden = page.studies.length < 2;
}

/** Fill all selection lists with the names of the columns. */
function fillChoices() {
  const several = page.studies.length > 1, settings = page.columns.filter((c) => c.role === "setting");
  const metrics = page.columns.filter((c) => c.role === "metric" && c.name !== "success");
  const all = [...settings, ...page.columns.filter((c) => c.role !== "setting")].map((c) => c.name);
  const names = all.filter((name) => column(name).kind === "number");
  const half = 0.5 * Math.max(...settings.map((c) => c.known_count)), rank = (c) => 2 * (c.known_count >= half) + (c.values.length > 0);
  const varied = settings.filter((c) => c.count > 1).sort((a, b) => rank(b) - rank(a)).map((c) => c.name);
  const has = (name) => page.columns.some((c) => c.name === name && (c.kind === "word" || c.count > 1));
  const first = (...candidates) => candidates.find((name) => name && has(name)) || all[0];
  const start = {
    column: first(...varied, "study"), "map-value": "success", "map-x": first(varied[1], varied[0], several && "study", "end"), "map-y": first(varied[0], "end"),
    "plot-x": first(varied[0], "run"), "plot-y": first("final_distance", "settled", metrics[0] && metrics[0].name), "plot-colour_by": "success",
    "by-0": several ? "study" : first(varied[0]), "by-1": several ? varied[0] || "" : varied[1] || "",
    "median-0": has("settled") ? "settled" : "", "median-1": has("final_distance") ? "final_distance" : "",
  };
  const lists = {
    column: all, "map-value": ["success", ...metrics.map((c) => c.name)], "map-x": all, "map-y": all, "plot-x": all, "plot-y": all, "plot-colour_by": ["", ...all],
    "by-0": ["", ...all], "by-1": ["", ...all], "median-0": ["", ...names], "median-1": ["", ...names],
  };
  for (const [id, list] of Object.entries(lists)) {
    const previous = readChoice(id);
    $(id).textContent = "";
    for (const name of list) $(id).append(new Option(name ? columnLabel(name) : "–", name));
    $(id).value = previous !== undefined && list.includes(previous) ? previous : start[id];
    storeChoice(id);
  }
  $("operator").textContent = "";
  for (const one of page.operators) $("operator").append(new Option(one, one));
  fillValues();
  if (!view.hidden_columns) {
    const shown = ["run", ...varied, ...(several ? ["study"] : []), "end", "settled", "final_distance", "reason"];
    view.hidden_columns = page.columns.map((c) => c.name).filter((name) => !shown.includes(name));
  }
  $("columns").querySelectorAll("label").forEach((old) => old.remove());
  for (const { name } of page.columns) {
    const box = make("input"), line = make("label");
    box.type = "checkbox";
    box.checked = !view.hidden_columns.includes(name);
    box.addEventListener("change", () => {
      view.hidden_columns = box.checked ? view.hidden_columns.filter((n) => n !== name) : [...view.hidden_columns, name];
      writeAddress();
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

const CHOICE_KEYS = { by: "by", median: "medians", map: "map", plot: "plot" };
function readChoice(id) { const [part, key] = id.split("-"); return part in CHOICE_KEYS ? view[CHOICE_KEYS[part]][key] : undefined; }
function storeChoice(id) { const [part, key] = id.split("-"); if (part in CHOICE_KEYS) view[CHOICE_KEYS[part]][key] = $(id).value; }

function fillValues() {
  const { values, kind, unit, size } = column($("column").value);
  $("values").textContent = "";
  for (const value of scaleValues(values, { size })) $("values").append(new Option(typeof value === "number" ? String(+value.toPrecision(15)) : value));
  $("value").placeholder = kind === "word" ? "text" : unit || "number";
}

function applySelection() {
  view.first = 0;
  refresh();
}

function writeAddress() { history.replaceState(null, "", `#${encodeURIComponent(JSON.stringify(view))}`); }

function addFilters(filters) {
  const same = (a, b) => a[0] === b[0] && a[1] === b[1];
  view.filters = [...view.filters.filter((old) => !filters.some((one) => same(one, old) && one[1] !== "≠")), ...filters];
  applySelection();
}

function showFilters() {
  $("filters").textContent = "";
  view.filters.forEach((filter, i) => {
    const [name, operator, value] = filter, button = make("button", "", "chip");
    const text = operator.startsWith("is") ? `${name} ${operator}` : `${name} ${operator} ${formatIn(name, value)} ${column(name).unit}`;
    button.append(make("span", text.trim()), make("b", "×"));
    button.setAttribute("aria-label", `remove the filter ${text}`);
    button.addEventListener("click", () => { view.filters.splice(i, 1); applySelection(); });
    $("filters").append(button);
  });
  if (view.filters.length > 1) {
    const all = make("button", "Remove all");
    all.addEventListener("click", () => { view.filters = []; applySelection(); });
    $("filters").append(all);
  }
}

/** Send all queries of the page and show the answers, unless the selection has changed meanwhile. */
async function refresh() {
  writeAddress();
  showFilters();
  const number = ++page.queryNumber;
  if (!page.columns.length) { $("run-count").textContent = "no runs yet: they appear here as soon as a study has stored some"; return; }
  const parts = [[rowQuery(), storeRows], [{ do: "map", ...selection(), ...view.map }, showMap],
    [{ do: "points", ...selection(), ...view.plot }, showPoints],
    [{ do: "groups", ...selection(), by: [...new Set(view.by)].filter(Boolean), values: [...new Set(view.medians)].filter(Boolean) }, showGroups]];
  document.body.setAttribute("aria-busy", "true");
  await Promise.all(parts.map(async ([query, show]) => {
    try {
      const answer = await sendQuery(query);
      if (number === page.queryNumber) show(answer, query);
    } catch (error) { if (number === page.queryNumber) showError(error.message); }
  }));
  if (number === page.queryNumber) document.body.removeAttribute("aria-busy");
}

const rowQuery = () => ({ do: "rows", ...selection(), sort: page.columns.some((c) => c.name === view.sort) ? view.sort : "", descending: view.descending, first: view.first, count: ROWS });

function showMap(answer, { x, y, value }) {
  const scaleLabels = (axis, name) => ({ ...axis, labels: scaleValues(axis.labels, column(name)) });
  const shown = { ...answer, x: scaleLabels(answer.x, x), y: scaleLabels(answer.y, y), values: scaleValues(answer.values, column(value)) };
  drawMap($("cells"), $("scale"), shown, { x: column(x), y: column(y), value, unit: column(value).unit, isRate: column(value).is_binary }, addFilters);
}

let colours = {};
const colour = (name) => colours[name] ||= getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const points = new Points($("points"), colour, {
  onPoint: (at) => {
    $("point").textContent = at === null ? " " : `${at.study}, run ${at.run}: ${view.plot.x} ${formatValue(at.x)}, ${view.plot.y} ${formatValue(at.y)}`;
  },
  onPress: (at) => openRun(at.study, at.run),
  onSelect: (xs, ys) => {
    const range = (name, [low, high]) => column(name).kind === "number" ? [[name, "≥", toStored(name, low)], [name, "≤", toStored(name, high)]] : [];
    addFilters([...range(view.plot.x, xs), ...range(view.plot.y, ys)]);
  },
});

function showPoints(answer, { x, y, colour_by }) {
  points.success = colour_by === "success";
  points.show(answer, column(x), column(y));
  $("classes").textContent = "";
  if (colour_by) $("classes").append(columnLabel(colour_by));
  answer.classes.forEach((value, k) => {
    const mark = make("i");
    mark.style.setProperty("--shade", points.classColour(k));
    $("classes").append(mark, colour_by === "success" ? (value ? "success" : "no success") : formatIn(colour_by, value));
  });
  $("point").textContent = answer.uncounted ? `${answer.uncounted} runs have no value for these axes` : " ";
}

const percent = (v) => v === null ? "–" : `${(100 * v).toFixed(v > 0 && v < 0.1 || v > 0.9 && v < 1 ? 1 : 0)}`;

function showGroups(answer, { by, values }) {
  const table = $("group-table");
  table.textContent = "";
  const head = table.createTHead().insertRow();
  const heading = (text, number) => { const cell = make("th", text, number ? "number" : ""); cell.scope = "col"; head.append(cell); };
  by.forEach((name) => heading(columnLabel(name), column(name).kind === "number"));
  heading("runs", true); heading("success (%)", true); heading("95 % interval", true);
  values.forEach((name) => heading(column(name).is_binary ? `${name} (%)` : columnLabel(name), true));
  heading("most frequent failure");
  const body = table.createTBody();
  for (const group of answer.groups) {
    const row = body.insertRow(), cells = group.values.map((v, i) => [formatIn(by[i], v), column(by[i]).kind === "number"]);
    const [rate, low, high] = group.rate;
    cells.push([group.runs, true], [percent(rate), true], [`${percent(low)} – ${percent(high)}`, true],
      ...group.estimates.map(([value, lower, upper], i) =>
        [lower === undefined ? formatIn(values[i], value) : `${percent(value)} [${percent(lower)}, ${percent(upper)}]`, true]), [group.failure, false]);
    cells.forEach(([text, number], i) => {
      const cell = row.insertCell();
      cell.className = number ? "number" : "";
      if (i || !by.length) { cell.textContent = text; return; }
      const button = make("button", text, "plain");
      button.title = "show only these runs";
      cell.append(button);
    });
    if (by.length) row.addEventListener("click", () => addFilters(group.bounds));
  }
  if (answer.count > answer.groups.length) table.append(make("caption", `${answer.groups.length} of ${answer.count} groups`));
}

function storeRows(answer) {
  const all = page.studies.filter((s) => !view.hidden_studies.includes(s.name)).reduce((sum, s) => sum + s.runs, 0);
  const rate = answer.total ? ` ${answer.success_count} of them (${percent(answer.success_count / answer.total)} %) succeeded.` : "";
  $("run-count").textContent = `${answer.total === all ? "" : `${answer.total} of `}${all} runs of ${page.studies.length - view.hidden_studies.length} ${page.studies.length - view.hidden_studies.length === 1 ? "study" : "studies"}.${rate}`;
  page.rows = answer.rows; page.total = answer.total;
  showRows();
}

function showRows() {
  const table = $("rows"), names = page.columns.map((c) => c.name);
  // The outcome is next to the number of the run, so that it is visible in a narrow window.
  const ends = ["run", "end", "study"], last = ["reason", "remedy"], roles = { setting: 3, metric: 4 };
  const rank = (n) => ends.includes(n) ? ends.indexOf(n) : last.includes(n) ? 6 : roles[column(n).role] ?? 5;
  const order = [...names].sort((a, b) => rank(a) - rank(b));  // columns of the same rank keep their order
  const shown = order.filter((name) => !view.hidden_columns.includes(name));
  table.textContent = "";
  const head = table.createTHead().insertRow();
  for (const name of shown) {
    const cell = make("th", "", column(name).kind === "number" ? "number" : ""), button = make("button", columnLabel(name), "plain");
    cell.scope = "col";
    cell.setAttribute("aria-sort", view.sort === name ? (view.descending ? "descending" : "ascending") : "none");
    button.addEventListener("click", () => {
      view.descending = view.sort === name && !view.descending;
      view.sort = name;
      applySelection();
    });
    cell.append(button);
    head.append(cell);
  }
  const body = table.createTBody(), study = names.indexOf("study"), run = names.indexOf("run"), success = names.indexOf("success");
  for (const values of page.rows) {
    const row = body.insertRow();
    row.dataset.run = values[run];
    for (const name of shown) {
      const value = values[names.indexOf(name)], cell = row.insertCell(), text = formatInRun(name, value);
      cell.className = column(name).kind === "number" ? "number" : last.includes(name) ? "long" : "";
      if (name === "run") {
        const button = make("button", text, "plain");
        button.setAttribute("aria-label", `open run ${text} of ${values[study]}`);
        cell.append(button);
      } else if (name === "end") {
        cell.append(make("span", text.replace(/_/g, " "), values[success] === 1 ? "end good-end" : "end bad-end"));
      } else cell.textContent = text;
    }
    row.addEventListener("click", () => openRun(values[study], values[run]));
  }
  $("place").textContent = page.total ? `${view.first + 1} to ${view.first + page.rows.length} of ${page.total}` : "no runs meet all filters";
  $("previous-page").disabled = view.first === 0;
  $("next-page").disabled = view.first + page.rows.length >= page.total;
}

async function openRun(study, run) {
  const box = $("run");
  let row;
  try { row = (await sendQuery({ do: "run", study, run })).row; } catch (error) { showError(error.message); return; }
  box.textContent = "";
  const close = make("button", "Close"), title = make("h2", `Run ${run}`), top = make("div", "", "row"), where = make("p", study, "meta");
  top.append(title, make("span", "", "grow"), close);
  close.addEventListener("click", closeRun);
  const badges = make("p");
  badges.append(make("span", row.outcome || "unknown outcome", `badge ${/^converged/.test(row.outcome) ? "good" : "bad"}`));
  if (row.verdict) badges.append(make("span", row.verdict, `badge ${row.verdict === "goal_reached" ? "good" : "bad"}`));
  box.append(top, where, badges);
  if (row.success !== 1 && (row.reason || row.remedy)) {
    const reason = make("div", "", "reason");
    for (const [name, text] of [["Reason: ", row.reason], ["Remedy: ", row.remedy]]) {
      if (text) { const line = make("div"); line.append(make("b", name), text); reason.append(line); }
    }
    box.append(reason);
  }
  const link = make("a", "Open the report", "action");
  link.href = `/run?${new URLSearchParams({ token, study, run })}`;
  link.target = "_blank";
  link.rel = "noopener";
  box.append(link, make("p", "Plots, film and path. It takes some seconds when it is opened first, because the run is repeated.", "note-below"));
  for (const [role, name] of [["setting", "Settings"], ["metric", "Metrics"], ["run", "Other columns"]]) {
    const entries = Object.entries(row).filter(([key]) => column(key).role === role && !["reason", "remedy", "outcome", "verdict", "end", "study", "run"].includes(key));
    if (!entries.length) continue;
    const table = make("table", "", "numbers");
    for (const [key, value] of entries) {
      const line = table.insertRow(), head = make("th", key);
      head.scope = "row";
      line.append(head, make("td", formatInRun(key, value), typeof value === "number" ? "number" : ""), make("td", column(key).unit));
    }
    box.append(make("h3", name), table);
  }
  box.hidden = false;
  box.scrollTop = 0;
  view.run = [study, run];
  writeAddress();
  document.body.classList.add("with-run");
  close.focus({ preventScroll: true });
}

function closeRun() {
  $("run").hidden = true;
  view.run = null;
  writeAddress();
  document.body.classList.remove("with-run");
}

async function compare() {
  $("comparison").textContent = "comparing …";
  $("differences").textContent = "";
  const first = $("first").value, second = $("second").value;
  let answer;
  try { answer = await sendQuery({ do: "compare", first, second }); } catch (error) { $("comparison").textContent = error.message; return; }
  const significant = answer.differences.filter((d) => d.is_significant), shown = $("chance").checked ? answer.differences : significant;
  $("comparison").textContent = `${significant.length} of ${answer.differences.filter((d) => d.verdict !== "untested").length} comparisons show a significant difference (α = ${answer.level}, Holm).`;
  if (!shown.length) return;
  const table = $("differences"), head = table.createTHead().insertRow(), body = table.createTBody();
  for (const [text, number] of [["settings"], ["quantity"], [first, true], [second, true], ["second is"], ["p", true], ["compared", true]]) {
    const cell = make("th", text, number ? "number" : "");
    cell.scope = "col";
    head.append(cell);
  }
  for (const d of shown.slice(0, 300)) {
    const row = body.insertRow();
    for (const [text, name] of [[d.group], [columnLabel(d.metric)], [formatIn(d.metric, d.before), "number"], [formatIn(d.metric, d.after), "number"],
      [{ chance: "no significant difference", untested: "not tested" }[d.verdict] || d.verdict.toLowerCase(), d.is_significant ? d.verdict.toLowerCase() : ""],
      [d.p === null ? "–" : d.p.toPrecision(2), "number"], [`${d.count} ${d.paired ? "pairs" : "runs"}`, "number"]]) {
      const cell = row.insertCell();
      cell.textContent = text;
      cell.className = name || "";
    }
  }
}

$("filter").addEventListener("submit", (event) => {
  event.preventDefault();
  const name = $("column").value, operator = $("operator").value, text = $("value").value.trim(), free = operator.startsWith("is");
  const number = column(name).kind === "number" && operator !== "contains";
  if (!free && (text === "" || number && !Number.isFinite(+text))) { showError(`${name} ${operator} needs a ${number ? "number" : "text"}`); $("value").focus(); return; }
  showError("");
  $("value").value = "";
  addFilters([[name, operator, free ? null : number ? toStored(name, +text) : text]]);
});
$("column").addEventListener("change", fillValues);
for (const id of ["map-value", "map-x", "map-y", "plot-x", "plot-y", "plot-colour_by", "by-0", "by-1", "median-0", "median-1"]) {
  $(id).addEventListener("change", () => { storeChoice(id); refresh(); });
}
const turnPage = (by) => { view.first = Math.max(0, view.first + by); refresh(); };
$("previous-page").addEventListener("click", () => turnPage(-ROWS));
$("next-page").addEventListener("click", () => turnPage(ROWS));
$("pair").addEventListener("submit", (event) => { event.preventDefault(); compare(); });
$("chance").addEventListener("change", () => { if ($("differences").rows.length || $("comparison").textContent) compare(); });
addEventListener("keydown", (event) => { if (event.key === "Escape" && view.run) closeRun(); });

document.addEventListener("themechange", () => {
  colours = {};
  points.draw();
  refresh();
});
updateStudies(true);
setInterval(() => { if (!document.hidden) updateStudies(); }, UPDATE_PERIOD);
window.arasBrowser = { page, view, points, addFilters, updateStudies };  // for tests
