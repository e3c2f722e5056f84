// The map of cells, and the scatter plot by uPlot.

import { formatNumber } from "./charts.js";

const COLOUR_MAP = getComputedStyle(document.documentElement).getPropertyValue("--colour-map").split(",")
  .map((c) => c.trim()).map((c) => [1, 3, 5].map((i) => parseInt(c.slice(i, i + 2), 16)));
const WIDE_RATIO = 100;   // an axis is logarithmic if the maximum divided by the minimum is larger
const POINT_RADIUS = 14;  // px; the pointer selects the nearest point within this distance

export const make = (tag, text = "", name = "") => {
  const element = document.createElement(tag);
  if (text !== "") element.textContent = text;
  if (name) element.className = name;
  return element;
};
/** Return values, which can be in lists, in the unit of their column. */
export const scaleValues = (value, { size = 1 }) => Array.isArray(value) ? value.map((v) => scaleValues(v, { size }))
  : typeof value === "number" ? value / size : value;
export const formatHeading = (name, unit) => unit ? `${name} (${unit})` : name;
export const formatValue = (value) => {
  if (value === null || value === undefined || value === "") return "–";
  if (typeof value === "number") return Number.isInteger(value) ? String(value) : formatNumber(value).replace(/(\.\d*?)0+$/, "$1").replace(/\.$/, "");
  return Array.isArray(value) ? `${formatValue(value[0])} … ${formatValue(value[1])}` : String(value);
};

/** Return the colour [red, green, blue], 0 to 255, of a value from 0 to 1. */
function mapColour(fraction) {
  const at = Math.min(Math.max(fraction, 0), 1) * (COLOUR_MAP.length - 1), low = Math.min(Math.floor(at), COLOUR_MAP.length - 2);
  return COLOUR_MAP[low].map((c, i) => Math.round(c + (at - low) * (COLOUR_MAP[low + 1][i] - c)));
}
/** Return black or white, whichever has the higher contrast with a colour. */
function textColour(rgb) {
  const [r, g, b] = rgb.map((c) => { c /= 255; return c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4; });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b > 0.179 ? "black" : "white";
}

/** Draw the map into a table; a click on a cell calls `onPress` with its filters. */
export function drawMap(table, scale, answer, { x, y, value, unit, isRate }, onPress) {
  table.textContent = scale.textContent = "";
  const sizes = answer.runs.flat(), known = answer.values.flat().filter((v) => v !== null);
  if (!known.length) { table.append(make("caption", "no runs with these values")); return; }
  const low = isRate ? 0 : Math.min(...known), high = isRate ? 1 : Math.max(...known);
  const plain = (v) => isRate ? `${Math.round(100 * v)}` : formatValue(v);
  const few = answer.x.labels.length <= 12;
  const caption = make("caption", "", "hidden");
  caption.textContent = `${value} by ${y.name} (rows) and ${x.name} (columns)`;
  const columns = make("colgroup");
  columns.append(make("col"));
  table.append(caption, columns);
  const tall = Math.max(24, Math.min(54, Math.floor(290 / answer.y.labels.length)));
  for (let i = answer.y.labels.length - 1; i >= 0; i--) {
    const row = table.insertRow(), head = make("th", formatValue(answer.y.labels[i]));
    head.scope = "row";
    row.append(head);
    answer.x.labels.forEach((label, j) => {
      const cell = row.insertCell(), v = answer.values[i][j], runs = answer.runs[i][j];
      cell.style.height = `${tall}px`;
      if (!runs) return;
      const button = make("button", v === null ? "–" : few ? plain(v) + (isRate ? "%" : "") : "");
      const where = `${y.name} ${formatValue(answer.y.labels[i])}, ${x.name} ${formatValue(label)}`;
      const text = `${where}: ${v === null ? "no number" : `${value} ${plain(v)}${isRate ? " %" : unit && ` ${unit}`}`}, ${runs} runs`;
      button.title = text;
      button.setAttribute("aria-label", text);
      if (v !== null) {
        const rgb = mapColour(high > low ? (v - low) / (high - low) : 1);
        button.style.background = `rgb(${rgb})`;
        button.style.color = textColour(rgb);
      }
      button.addEventListener("click", () => onPress([...answer.y.bounds[i].map((b) => [y.name, ...b]),
        ...answer.x.bounds[j].map((b) => [x.name, ...b])]));
      cell.append(button);
    });
  }
  const foot = table.createTFoot().insertRow();
  const corner = make("td", `${formatHeading(y.name, y.unit)} ↑`, "corner");
  foot.append(corner);
  const step = Math.ceil(answer.x.labels.length / 10);  // at most ten labels fit
  answer.x.labels.forEach((label, j) => {
    if (j % step) return;
    const head = make("th", formatValue(label));
    head.scope = step > 1 ? "colgroup" : "col";
    head.colSpan = Math.min(step, answer.x.labels.length - j);
    if (step > 1) head.style.textAlign = "left";
    foot.append(head);
  });
  const titleRow = table.tFoot.insertRow();
  titleRow.append(make("td"));
  const title = make("td", `${formatHeading(x.name, x.unit)} →`, "along");
  title.colSpan = answer.x.labels.length;
  titleRow.append(title);
  const bar = make("i", "", "scale");
  scale.append(`${plain(low)} `, bar, ` ${plain(high)}${isRate ? ` % of the runs${value === "success" ? " succeed" : `: ${value}`}` : ` ${formatHeading(value, unit)}, median`}`);
  if (answer.uncounted) scale.append(`; ${answer.uncounted} runs have no value for these axes`);
  return Math.max(...sizes);
}

const decodeArray = (text, Kind) => new Kind(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);

/** A scatter plot with a point for each run. */
export class Points {
  /** Callbacks: `onPoint` gets the point below the pointer or null, `onPress` a clicked point, `onSelect` ranges of x and y. */
  constructor(box, colour, { onPoint, onPress, onSelect }) {
    Object.assign(this, { box, colour, onPoint, onPress, onSelect, at: null });
    new ResizeObserver(() => this.plot && this.plot.setSize(this._plotSize())).observe(box);
  }

  _plotSize() { return { width: Math.max(this.box.clientWidth, 120), height: this.box.clientHeight }; }

  show(answer, x, y) {
    this.answer = answer;
    Object.assign(this, { x, y, xs: decodeArray(answer.x.values, Float32Array), ys: decodeArray(answer.y.values, Float32Array),
      colours: decodeArray(answer.colours, Uint8Array), study: decodeArray(answer.study, Int32Array), run: decodeArray(answer.run, Int32Array) });
    for (const [values, { size = 1 }] of [[this.xs, x], [this.ys, y]]) if (size !== 1) for (let i = 0; i < values.length; i++) values[i] /= size;
    for (const [values, { labels }] of [[this.xs, answer.x], [this.ys, answer.y]]) {  // spread points with equal texts
      if (labels.length) for (let i = 0; i < values.length; i++) values[i] += 0.5 * (((i * 0.6180339887) % 1) - 0.5);
    }
    this.draw();
  }

  draw() {
    if (!this.answer) return;
    if (this.plot) this.plot.destroy();
    const ink = this.colour("soft"), grid = { stroke: this.colour("line"), width: 1 }, font = '11px system-ui, "DejaVu Sans", sans-serif';
    const axes = [[this.xs, this.answer.x, this.x], [this.ys, this.answer.y, this.y]].map(([values, { labels }, column], n) => {
      let low = Infinity, high = -Infinity;
      for (const v of values) { if (v < low) low = v; if (v > high) high = v; }
      if (labels.length) { low = -0.6; high = labels.length - 0.4; }
      const log = !labels.length && low > 0 && high / low > WIDE_RATIO, margin = high > low ? 0.04 * (high - low) : Math.abs(high) || 1;
      const range = !Number.isFinite(low) ? [0, 1] : log ? [low / 1.2, high * 1.2] : [low - margin, high + margin];
      const tens = (u, splits) => splits.map((v) => !log || Math.abs(Math.log10(v) % 1) < 1e-9 ? v : null);
      return { scale: { time: false, distr: log ? 3 : 1, range: () => range }, axis: {
        stroke: ink, filter: tens, grid: { ...grid, filter: tens }, ticks: { ...grid, filter: tens }, font, size: n ? 62 : 30, label: formatHeading(column.name, column.unit),
        labelSize: 18, labelFont: font, labelGap: 0,
        splits: labels.length ? () => labels.map((_, i) => i) : undefined,
        values: (u, at) => at.map((v) => v === null ? null : labels.length ? formatValue(labels[v]).slice(0, n ? 9 : 14)
          : v && Math.abs(v) < 1e-3 ? v.toExponential(0) : String(+v.toPrecision(5))),
      } };
    });
    const [xe, ye] = axes, [low, high] = xe.scale.range();
    this.plot = new uPlot({
      ...this._plotSize(), legend: { show: false }, scales: { x: xe.scale, y: ye.scale }, axes: [xe.axis, ye.axis],
      series: [{}, { points: { show: false }, stroke: "transparent" }],
      cursor: { drag: { x: true, y: true, uni: 12, setScale: false }, points: { show: false }, x: false, y: false },
      hooks: {
        draw: [(u) => this._drawPoints(u)],
        setCursor: [(u) => this._findPoint(u)],
        setSelect: [(u) => {
          const { left, top, width, height } = u.select;
          if (width > 4 && height > 4) {
            this.onSelect([u.posToVal(left, "x"), u.posToVal(left + width, "x")], [u.posToVal(top + height, "y"), u.posToVal(top, "y")]);
          }
          u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
        }],
      },
    }, [[low, high], [null, null]], this.box);
    this.plot.over.addEventListener("click", () => { if (this.at !== null) this.onPress(this._describePoint(this.at)); });
  }

  _describePoint(i) { return { study: this.answer.studies[this.study[i]], run: this.run[i], x: this.xs[i], y: this.ys[i] }; }

  _drawPoints(u) {
    const { ctx, bbox } = u, many = this.xs.length, ratio = window.devicePixelRatio || 1;
    const size = (many < 2000 ? 3 : many < 20000 ? 2 : 1.2) * ratio;
    const toPixels = (name, values) => {
      const out = new Float32Array(values.length);
      for (let i = 0; i < values.length; i++) out[i] = u.valToPos(values[i], name, true);
      return out;
    };
    this.px = toPixels("x", this.xs); this.py = toPixels("y", this.ys);
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    ctx.globalAlpha = many < 2000 ? 0.8 : many < 20000 ? 0.5 : 0.3;
    for (let k = 0; k <= Math.max(this.answer.classes.length, 0); k++) {
      ctx.fillStyle = this.classColour(k);
      ctx.beginPath();
      for (let i = 0; i < many; i++) {
        if (this.colours[i] !== k) continue;
        if (many < 20000) { ctx.moveTo(this.px[i] + size, this.py[i]); ctx.arc(this.px[i], this.py[i], size, 0, 6.2832); }
        else ctx.rect(this.px[i] - size, this.py[i] - size, 2 * size, 2 * size);
      }
      ctx.fill();
    }
    ctx.restore();
  }

  /** Return the colour of a class; for success it is blue, for failure vermilion. */
  classColour(k) {
    const { classes } = this.answer;
    if (k >= classes.length && classes.length) return this.colour("soft");
    return this.colour(`curve-${this.success ? (classes[k] === 1 ? 0 : 1) : k % 8}`);
  }

  _findPoint(u) {
    const { left, top } = u.cursor, ratio = window.devicePixelRatio || 1;
    let best = (POINT_RADIUS * ratio) ** 2, at = null;
    if (left >= 0 && this.px) {
      const x = left * ratio + u.bbox.left, y = top * ratio + u.bbox.top;
      for (let i = 0; i < this.px.length; i++) {
        const d = (this.px[i] - x) ** 2 + (this.py[i] - y) ** 2;
        if (d < best) { best = d; at = i; }
      }
    }
    this.at = at;
    u.over.style.cursor = at === null ? "crosshair" : "pointer";
    this.onPoint(at === null ? null : this._describePoint(at));
  }
}
