// Plots of the run, drawn by uPlot: the whole run, its newest part, or a part that was selected by dragging.

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
export const NEWEST = 10;  // duration of the newest part, s
const MIN_SPAN = 4;  // shortest range of the time axis, s
const MAX_NAMES = 8;  // largest number of curves with names in a plot; further curves are thinner
const MAX_AXES = 3;   // largest number of axes in a plot, one above the other
const FONT = '11px system-ui, "DejaVu Sans", sans-serif';
const AXIS = 58, TIMES = 22;  // width of the value axis and height of the time axis, px
// Shortest range of a value axis: this many tolerances, so that an error within its tolerance looks small. If the
// tolerance is unknown: this fraction of the range of the whole run.
const TOLERANCES = 10, RUN_FRACTION = 0.05;

/** Return the value of a curve as text that follows its name; empty if there is no value. */
const formatValue = (v) => v === null || v === undefined ? "" : ` ${v.toFixed(4).replace(/^-(0\.0*)$/, "$1")}`;

/** Return pairs of a unit and the indices of its curves; one pair with all curves if there are too many units. */
export function groupByUnit(units, count) {
  const all = [...Array(count).keys()], found = new Map();
  if (units.length === count) for (const i of all) found.set(units[i], [...(found.get(units[i]) || []), i]);
  return found.size && found.size <= MAX_AXES ? [...found] : [["", all]];
}

/** The part of the run that all plots show. */
export class TimeRange {
  /** `onChange()` is called after the user has chosen another part. */
  constructor(onChange) { Object.assign(this, { onChange, part: "whole", selected: [0, 0] }); }

  /** Show the "whole" run, or its "newest" part. */
  show(part) { this.part = part; this.onChange(); }

  /** Show a part of the run between two stamps, s. */
  select(first, last) { Object.assign(this, { part: "selected", selected: [first, last] }); this.onChange(); }

  /** Return the first and the last stamp to show. A selection is given up when another run has started. */
  find(samples) {
    const first = samples.length ? samples[0][0] : 0, last = samples.length ? samples[samples.length - 1][0] : 0;
    if (this.part === "selected") {
      if (this.selected[0] <= last && this.selected[1] >= first) return this.selected;
      this.part = "whole";
    }
    const start = this.part === "newest" ? Math.max(first, last - NEWEST) : first;
    return [start, Math.max(last, start + MIN_SPAN)];
  }
}

export class Plot {
  /** `pick(sample)` returns the values of the solid curves, `dashed(sample)` those of the dashed curves; it may be null. */
  constructor(box, time, pick, dashed = null) {
    Object.assign(this, { box, time, pick, dashed, names: [], units: [], tolerances: [], charts: [], range: [0, MIN_SPAN], mark: "" });
    this.legend = document.createElement("p");
    this.legend.className = "names";
    this.area = document.createElement("div");
    this.area.className = "areas";
    box.append(this.legend, this.area);
  }

  draw(samples) {
    if (!this.area.clientWidth || !this.area.clientHeight) return;
    this.range = this.time.find(samples);
    const solid = samples.map(this.pick), dashedValues = this.dashed ? samples.map(this.dashed) : [];
    const values = solid.length ? solid[solid.length - 1] : [];
    const count = Math.max(values.length, this.names.length);
    const groups = groupByUnit(this.units, count), mark = JSON.stringify([groups, this.names]);
    if (mark !== this.mark) this._makeCharts(groups, mark);
    this.names.slice(0, MAX_NAMES).forEach((name, i) => { this.legend.children[i].lastChild.textContent = name + formatValue(values[i]); });
    const times = samples.map((s) => s[0]), column = (rows, i) => rows.map((row) => row[i] === undefined ? null : row[i]);
    for (const chart of this.charts) {
      const { plot, members, box } = chart, width = box.clientWidth, height = box.clientHeight;
      if (width !== plot.width || height !== plot.height) plot.setSize({ width, height });
      const curves = [...members.map((i) => column(solid, i)), ...(this.dashed ? members.map((i) => column(dashedValues, i)) : [])];
      chart.minRange = this._findMinRange(members, curves);
      plot.setData([times, ...curves]);
    }
  }

  /** Draw the charts again in the present colours. */
  restyle(samples) { this.mark = ""; this.draw(samples); }

  /** Return the shortest range of the value axis of some curves. */
  _findMinRange(members, curves) {
    const known = members.map((i) => this.tolerances[i]).filter((t) => Number.isFinite(t));
    if (known.length) return TOLERANCES * Math.max(...known);
    let low = Infinity, high = -Infinity;
    for (const curve of curves) for (const v of curve) if (v !== null) { low = Math.min(low, v); high = Math.max(high, v); }
    return high > low ? RUN_FRACTION * (high - low) : 0;
  }

  /** Create the charts and names for a new set of curves. */
  _makeCharts(groups, mark) {
    this.mark = mark;
    for (const { plot } of this.charts) plot.destroy();
    this.area.textContent = this.legend.textContent = "";
    this.names.slice(0, MAX_NAMES).forEach((_, i) => {
      const name = document.createElement("span"), line = document.createElement("i");
      line.style.background = colour(`curve-${i % 8}`);
      name.append(line, "");
      this.legend.append(name);
    });
    this.charts = groups.map(([unit, members], k) => {
      const box = document.createElement("div"), last = k === groups.length - 1, chart = { box, members, minRange: 0 };
      box.style.flexGrow = last ? 1.3 : 1;  // the lowest chart also has the time axis
      this.area.append(box);
      chart.plot = this._makeChart(chart, unit, last);
      return chart;
    });
  }

  _makeChart(chart, unit, last) {
    const ink = colour("quiet"), grid = { stroke: colour("grid"), width: 1 }, { box, members } = chart;
    const curve = (i, dash) => ({ stroke: colour(`curve-${i % 8}`), width: i < MAX_NAMES ? 1.7 : 0.8, dash, alpha: dash ? 0.75 : 1,
      points: { show: false }, spanGaps: false });
    return new uPlot({
      width: Math.max(box.clientWidth, 60), height: Math.max(box.clientHeight, 40), legend: { show: false },
      padding: [6, 16, last ? 0 : 6, 0],  // on the right, half of the last time
      cursor: { x: false, y: false, points: { show: false }, drag: { x: true, y: false, setScale: false },
        bind: { dblclick: () => () => this.time.show("whole") } },
      hooks: { setSelect: [(u) => this._onSelect(u)] },
      scales: { x: { time: false, range: () => this.range }, y: { range: (u, low, high) => padRange(low, high, chart.minRange) } },
      axes: [
        { show: last, stroke: ink, grid, ticks: { show: false }, font: FONT, size: TIMES, gap: 2, values: (u, at) => at.map((t) => `${+t.toFixed(3)} s`) },
        { stroke: ink, grid, ticks: { show: false }, font: FONT, size: AXIS - (unit ? 16 : 0), gap: 4, space: 18,
          label: unit || undefined, labelSize: unit ? 16 : 0, labelGap: 0, labelFont: FONT, values: (u, at) => at.map((v) => String(+v.toPrecision(5))) },
      ],
      series: [{}, ...members.map((i) => curve(i)), ...(this.dashed ? members.map((i) => curve(i, [4, 3])) : [])],
    }, [[], ...members.map(() => []), ...(this.dashed ? members.map(() => []) : [])], box);
  }

  _onSelect(u) {
    const { left, width } = u.select;
    if (width <= 3) return;
    const ends = [u.posToVal(left, "x"), u.posToVal(left + width, "x")];
    u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.time.select(...ends);
  }
}

/** Extend a range of values to `shortest`, and by 8 % on each side. A short range that contains 0 is centred on 0. */
function padRange(low, high, shortest = 0) {
  if (!Number.isFinite(low) || !Number.isFinite(high)) return [-1, 1];
  const span = Math.max(high - low, shortest) || Math.max(1e-3, 0.1 * Math.abs(low));
  const isAtZero = Math.max(-low, high) <= span / 2, middle = isAtZero ? 0 : (low + high) / 2;
  return [middle - 0.58 * span, middle + 0.58 * span];
}
