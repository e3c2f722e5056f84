// Scrolling plots of the last seconds, drawn by uPlot.

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const MAX_SPAN = 20, MIN_SPAN = 4;  // longest and shortest range of the time axis, s
const MAX_NAMES = 8;  // largest number of curves with names in a plot; further curves are thinner
const MAX_AXES = 3;   // largest number of axes in a plot, one above the other
const FONT = '11px system-ui, "DejaVu Sans", sans-serif';
const AXIS = 58, TIMES = 22;  // width of the value axis and height of the time axis, px

/** Return the value of a curve as text that follows its name; empty if there is no value. */
const formatValue = (v) => v === null || v === undefined ? "" : ` ${v.toFixed(4).replace(/^-(0\.0*)$/, "$1")}`;

/** Return pairs of a unit and the indices of its curves; one pair with all curves if there are too many units. */
export function groupByUnit(units, count) {
  const all = [...Array(count).keys()], found = new Map();
  if (units.length === count) for (const i of all) found.set(units[i], [...(found.get(units[i]) || []), i]);
  return found.size && found.size <= MAX_AXES ? [...found] : [["", all]];
}

export class Plot {
  /** `pick(sample)` returns the values of the solid curves, `dashed(sample)` (optional) those of the dashed curves. */
  constructor(box, pick, dashed) {
    Object.assign(this, { box, pick, dashed, names: [], units: [], charts: [], range: [0, MIN_SPAN], mark: "" });
    this.legend = document.createElement("p");
    this.legend.className = "names";
    this.area = document.createElement("div");
    this.area.className = "areas";
    box.append(this.legend, this.area);
  }

  draw(samples) {
    if (!this.area.clientWidth || !this.area.clientHeight) return;
    const newest = samples.length ? samples[samples.length - 1][0] : 0;
    const first = Math.max(newest - MAX_SPAN, samples.length ? samples[0][0] : 0);
    this.range = [first, Math.max(newest, first + MIN_SPAN)];
    const shown = samples.filter((s) => s[0] >= first), solid = shown.map(this.pick);
    const dashedValues = this.dashed ? shown.map(this.dashed) : [];
    const values = solid.length ? solid[solid.length - 1] : [];
    const groups = groupByUnit(this.units, values.length), mark = JSON.stringify([groups, this.names]);
    if (mark !== this.mark) this._makeCharts(groups, mark);
    this.names.slice(0, MAX_NAMES).forEach((name, i) => { this.legend.children[i].textContent = name + formatValue(values[i]); });
    const times = shown.map((s) => s[0]), column = (rows, i) => rows.map((row) => row[i] === undefined ? null : row[i]);
    for (const { plot, members, box } of this.charts) {
      const width = box.clientWidth, height = box.clientHeight;
      if (width !== plot.width || height !== plot.height) plot.setSize({ width, height });
      plot.setData([times, ...members.map((i) => column(solid, i)), ...(this.dashed ? members.map((i) => column(dashedValues, i)) : [])]);
    }
  }

  /** Create the charts and names for a new set of curves. */
  _makeCharts(groups, mark) {
    this.mark = mark;
    for (const { plot } of this.charts) plot.destroy();
    this.area.textContent = this.legend.textContent = "";
    this.names.slice(0, MAX_NAMES).forEach((_, i) => {
      const name = document.createElement("span");
      name.style.color = colour(`curve-${i % 8}`);
      this.legend.append(name);
    });
    this.charts = groups.map(([unit, members], k) => {
      const box = document.createElement("div"), last = k === groups.length - 1;
      box.style.flexGrow = last ? 1.3 : 1;  // the lowest chart also has the time axis
      this.area.append(box);
      return { box, members, plot: this._makeChart(box, unit, members, last) };
    });
  }

  _makeChart(box, unit, members, last) {
    const ink = colour("quiet"), grid = { stroke: colour("grid"), width: 1 };
    const curve = (i, dash) => ({ stroke: colour(`curve-${i % 8}`), width: i < MAX_NAMES ? 1.7 : 0.8, dash, alpha: dash ? 0.75 : 1,
      points: { show: false }, spanGaps: false });
    return new uPlot({
      width: Math.max(box.clientWidth, 60), height: Math.max(box.clientHeight, 40), legend: { show: false }, cursor: { show: false },
      padding: [6, 8, last ? 0 : 6, 0],
      scales: { x: { time: false, range: () => this.range }, y: { range: (u, low, high) => padRange(low, high) } },
      axes: [
        { show: last, stroke: ink, grid, ticks: { show: false }, font: FONT, size: TIMES, gap: 2, values: (u, at) => at.map((t) => `${+t.toFixed(3)} s`) },
        { stroke: ink, grid, ticks: { show: false }, font: FONT, size: AXIS - (unit ? 16 : 0), gap: 4, space: 18,
          label: unit || undefined, labelSize: unit ? 16 : 0, labelGap: 0, labelFont: FONT, values: (u, at) => at.map((v) => String(+v.toPrecision(5))) },
      ],
      series: [{}, ...members.map((i) => curve(i)), ...(this.dashed ? members.map((i) => curve(i, [4, 3])) : [])],
    }, [[], ...members.map(() => []), ...(this.dashed ? members.map(() => []) : [])], box);
  }
}

/** Extend a range of values by 8 % on each side. */
function padRange(low, high) {
  if (!Number.isFinite(low) || !Number.isFinite(high)) return [-1, 1];
  const margin = Math.max(0.08 * (high - low), 1e-3);
  return [low - margin, high + margin];
}
