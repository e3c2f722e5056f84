// Scrolling plots: time to the left, the newest at the right.

const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const COLOURS = [...Array(8).keys()].map((i) => colour(`curve-${i}`));
const [QUIET, ZERO, GRID] = ["quiet", "zero", "grid"].map(colour);
const SPAN = 20, LEAST = 4;  // s that are shown, at most and at least
const MOST = 8;   // curves with a name; the others are thin
const GAP = 12;   // pixels between two names
const STRIPS = 3, BETWEEN = 16;  // axes above each other at most, and pixels between two

/** A value behind its name; nothing where there is none. */
function said(value, digits) {
  if (value === null || value === undefined) return "";
  return ` ${value.toFixed(digits).replace(/^-(0\.0*)$/, "$1")}`;
}

/** Ticks between two bounds: round numbers, about `count` of them. */
export function ticks(low, high, count) {
  const rough = (high - low) / count, power = Math.pow(10, Math.floor(Math.log10(rough)));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough) || rough;
  const first = Math.ceil(low / step - 1e-9), found = [];
  for (let i = first; i * step <= high + 1e-9 * step; i++) found.push(i * step);
  return { found, digits: Math.max(0, Math.min(6, -Math.floor(Math.log10(step) + 1e-9))) };
}

/** Curves that share an axis: numbers of those of one unit, each with its unit. */
export function strips(units, count) {
  const all = [...Array(count).keys()], found = new Map();
  if (units.length === count) for (const i of all) found.set(units[i], [...(found.get(units[i]) || []), i]);
  return found.size && found.size <= STRIPS ? [...found] : [["", all]];
}

export class Plot {
  /** `pick(sample)`: the solid curves' numbers; `dashed(sample)`: those beside them, or nothing. */
  constructor(canvas, pick, dashed) {
    Object.assign(this, { canvas, pick, dashed, names: [], units: [] });
  }

  draw(samples) {
    const scale = Math.min(window.devicePixelRatio || 1, 2);
    const width = this.canvas.clientWidth, height = this.canvas.clientHeight;
    if (!width || !height) return;
    if (this.canvas.width !== Math.round(width * scale)) this.canvas.width = Math.round(width * scale);
    if (this.canvas.height !== Math.round(height * scale)) this.canvas.height = Math.round(height * scale);
    const c = this.canvas.getContext("2d");
    c.setTransform(scale, 0, 0, scale, 0, 0);
    c.clearRect(0, 0, width, height);
    c.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    c.textBaseline = "middle";
    const newest = samples.length ? samples[samples.length - 1][0] : 0;
    const first = Math.max(newest - SPAN, samples.length ? samples[0][0] : 0);
    const last = Math.max(newest, first + LEAST);
    const shown = samples.filter((s) => s[0] >= first);
    const area = { left: 52, right: width - 6, top: 18, bottom: height - 18 };
    area.X = (t) => area.left + (t - first) / (last - first) * (area.right - area.left);
    const values = shown.length ? this.pick(shown[shown.length - 1]) : [];
    const groups = strips(this.units, values.length);
    const each = (area.bottom - area.top - (groups.length - 1) * BETWEEN) / groups.length;
    groups.forEach(([unit, members], k) => {
      const top = area.top + k * (each + BETWEEN);
      this._strip(c, shown, members, unit, { ...area, top, bottom: top + each });
    });
    c.textAlign = "center";
    for (const t of ticks(first, last, 5).found) {
      if (t < 0 || area.X(t) > area.right - 8) continue;  // its letters would be cut off
      c.fillStyle = QUIET; c.fillText(`${t} s`, area.X(t), height - 7);
    }
    this._names(c, values, area);
  }

  /** The curves of these numbers over an axis of their own. */
  _strip(c, shown, members, unit, { left, right, top, bottom, X }) {
    let low = Infinity, high = -Infinity;
    for (const s of shown) {
      for (const numbers of [this.pick(s), this.dashed ? this.dashed(s) : []]) {
        for (const i of members) {
          const v = numbers[i];
          if (v === null || v === undefined) continue;
          low = Math.min(low, v); high = Math.max(high, v);
        }
      }
    }
    if (!(low <= high)) { low = -1; high = 1; }
    const room = Math.max(0.08 * (high - low), 1e-3);
    low -= room; high += room;
    const Y = (v) => bottom - (v - low) / (high - low) * (bottom - top);
    const marks = ticks(low, high, Math.max(2, (bottom - top) / 20));
    for (const v of marks.found) {
      c.strokeStyle = Math.abs(v) < 1e-12 ? ZERO : GRID;
      c.beginPath(); c.moveTo(left, Y(v)); c.lineTo(right, Y(v)); c.stroke();
      c.fillStyle = QUIET; c.textAlign = "right";
      c.fillText(v.toFixed(marks.digits), left - 6, Y(v));
    }
    c.save();
    c.beginPath(); c.rect(left, top - 2, right - left, bottom - top + 4); c.clip();
    const curves = (numbers, dash, opacity) => {
      c.setLineDash(dash); c.globalAlpha = opacity;
      for (const i of members) {
        c.strokeStyle = COLOURS[i % COLOURS.length]; c.lineWidth = i < MOST ? 1.7 : 0.8;
        c.beginPath();
        let pen = false;
        for (const s of shown) {
          const v = numbers(s)[i];
          if (v === null || v === undefined) { pen = false; continue; }
          if (pen) c.lineTo(X(s[0]), Y(v)); else c.moveTo(X(s[0]), Y(v));
          pen = true;
        }
        c.stroke();
      }
      c.setLineDash([]); c.globalAlpha = 1;
    };
    if (this.dashed) curves(this.dashed, [4, 3], 0.75);
    curves(this.pick, [], 1);
    c.restore();
    if (!unit) return;
    c.save();  // upwards, left of the numbers, where no curve is
    c.translate(7, (top + bottom) / 2); c.rotate(-Math.PI / 2);
    c.fillStyle = QUIET; c.textAlign = "center";
    c.fillText(unit, 0, 0);
    c.restore();
  }

  /** Above the axes, each in its colour. */
  _names(c, values, { left, right }) {
    c.textAlign = "left";
    const named = this.names.slice(0, MOST), across = right - left + GAP;
    // With as many digits as there is room for, rather none than a name left out.
    const widths = (texts) => texts.reduce((sum, text) => sum + c.measureText(text).width + GAP, 0);
    let texts = named;
    for (const digits of [4, 3, 2, 1]) {
      const longer = named.map((name, i) => name + said(values[i], digits));
      if (widths(longer) <= across) { texts = longer; break; }
    }
    let x = left;
    texts.forEach((text, i) => {
      c.fillStyle = COLOURS[i % COLOURS.length];
      c.fillText(text, x, 8);
      x += c.measureText(text).width + GAP;
    });
  }
}
