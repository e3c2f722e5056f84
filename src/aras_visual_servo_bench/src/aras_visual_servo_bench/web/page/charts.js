// Time plots drawn by uPlot, with one cursor and one time range for all of them.

const GAP = 0.04;  // margin above and below the curves, as a fraction of their range
const nearestIndex = (times, t) => {  // index of the time nearest to t, by bisection
  let low = 0, high = times.length - 1;
  while (high - low > 1) { const m = (low + high) >> 1; if (times[m] <= t) low = m; else high = m; }
  return Math.abs(times[high] - t) < Math.abs(times[low] - t) ? high : low;
};

/** Return the index of the first of increasing times that is at least t. */
const lowerBound = (times, t) => {
  let low = 0, high = times.length;
  while (low < high) { const m = (low + high) >> 1; if (times[m] < t) low = m + 1; else high = m; }
  return low;
};

/**
 * Return the part [times, values] of a curve from `low` to `high`, with the next sample on each side.
 * Unknown values become null. If there are more than two samples per column of pixels, each column
 * keeps its smallest and its largest value, in their order. All curves get the same times then, which
 * differ from those of the samples by less than a column.
 */
export function decimate(times, values, [low, high], columns) {
  const start = lowerBound(times, low), end = lowerBound(times, high + 1e-12);
  const first = Math.max(start - 1, 0), last = Math.min(end + 1, times.length);
  const x = [], y = [], push = (t, v) => { x.push(t); y.push(Number.isFinite(v) ? v : null); };
  if (end - start <= 2 * columns) {
    for (let i = first; i < last; i++) push(times[i], values[i]);
    return [x, y];
  }
  const width = (high - low) / columns;
  if (first < start) push(times[first], values[first]);
  for (let k = 0, i = start; k < columns; k++) {
    const from = i, edge = k + 1 < columns ? low + (k + 1) * width : Infinity;
    let least = -1, largest = -1;
    for (; i < end && times[i] < edge; i++) {
      const v = values[i];
      if (!Number.isFinite(v)) continue;
      if (least < 0 || v < values[least]) least = i;
      if (largest < 0 || v > values[largest]) largest = i;
    }
    if (i === from) continue;
    const t = low + k * width;
    if (least < 0) { push(t + 0.5 * width, null); continue; }
    if (!Number.isFinite(values[from])) push(t + 0.1 * width, null);
    push(t + 0.3 * width, values[Math.min(least, largest)]);
    push(t + 0.6 * width, values[Math.max(least, largest)]);
    if (!Number.isFinite(values[i - 1])) push(t + 0.9 * width, null);
  }
  if (end < last) push(times[end], values[end]);
  return [x, y];
}

/** Return a number as text with three to five significant digits. */
export function formatNumber(v) {
  if (!Number.isFinite(v)) return "–";
  const size = Math.abs(v);
  if (size === 0) return "0";
  if (size < 1e-3 || size >= 1e5) return v.toExponential(2);
  return v.toPrecision(size >= 1000 ? 5 : 4);
}

export class Chart {
  /** `box`: parent element; `panel`: data of the panel; `page`: state that all charts share. */
  constructor(box, panel, page) {
    Object.assign(this, { box, panel, page, hidden: new Set(), isVisible: false });
    // The arrays of a curve are decoded when they are needed first: most charts are below the window.
    this.curves = panel.curves.map((c) => ({ ...c, get time() { return page.array(c.x); }, get values() { return page.array(c.y); } }));
    const title = document.createElement("h3");
    title.textContent = panel.title;
    this.plotBox = document.createElement("div");
    this.plotBox.className = "plot";
    this.legend = document.createElement("div");
    this.legend.className = "legend";
    box.append(title, this.plotBox, this.legend);
    if (panel.omitted_curves) {
      const note = document.createElement("p");
      note.className = "omitted";
      note.textContent = `Shows the ${this.curves.length} curves of ${this.curves.length + panel.omitted_curves} that `
        + "vary most; the tables in data/, next to this page, contain all of them.";
      box.append(note);
    }
    this.entries = this.curves.map((curve, i) => this._makeEntry(curve, i));
    this.legend.append(...this.entries.map((entry) => entry.button));
  }

  _makeEntry(curve, i) {
    const button = document.createElement("button"), mark = document.createElement("i");
    const name = document.createElement("span"), value = document.createElement("output");
    mark.className = curve.dashed ? "dashed" : curve.is_pale ? "pale" : "";
    mark.style.setProperty("--shade", `var(--curve-${curve.colour_index % 8})`);
    name.textContent = name.title = curve.name;
    button.append(mark, name, value);
    button.setAttribute("aria-pressed", "true");
    button.addEventListener("click", () => {
      if (!this.hidden.delete(i)) this.hidden.add(i);
      button.setAttribute("aria-pressed", String(!this.hidden.has(i)));
      this._showCurves();
    });
    return { button, value };
  }

  isShown(i) { return !this.hidden.has(i) && !this.page.hiddenRuns.has(this.curves[i].run); }

  _showCurves() {
    this.curves.forEach((curve, i) => {
      this.entries[i].button.hidden = this.page.hiddenRuns.has(curve.run);
      if (this.plot && this.plot.series[i + 1].show !== this.isShown(i)) this.plot.setSeries(i + 1, { show: this.isShown(i) });
    });
  }

  /** Create the plot. It is created again when the colours change. */
  draw() {
    if (this.plot) this.plot.destroy();
    const { page, panel } = this, ink = page.colour("soft"), grid = { stroke: page.colour("line"), width: 1 };
    const tens = (u, splits) => splits.map((v) => !panel.is_logarithmic || Math.abs(Math.log10(v) % 1) < 1e-9 ? v : null);
    const font = '11px system-ui, "DejaVu Sans", sans-serif';
    const [low, high] = this._findLevels();
    this.plot = new uPlot({
      width: Math.max(this.plotBox.clientWidth, 120), height: this.plotBox.clientHeight,
      legend: { show: false },
      scales: {
        x: { time: false, range: () => page.range },
        y: panel.is_logarithmic ? { distr: 3 } : { range: (u, lower, upper) => this._computeRange(lower, upper, low, high) },
      },
      axes: [
        { stroke: ink, grid, ticks: grid, font, size: 28, values: (u, at) => at.map((v) => `${+v.toPrecision(6)} s`) },
        { stroke: ink, grid: { ...grid, filter: tens }, ticks: { ...grid, filter: tens }, font, size: 58,
          values: (u, at) => at.map((v) => v === null ? null : Math.abs(v) >= 1e5 || (v && Math.abs(v) < 1e-3) ? v.toExponential(0) : String(+v.toPrecision(6))) },
      ],
      series: [{}, ...this.curves.map((c, i) => ({
        label: c.name, show: this.isShown(i), stroke: page.colour(`curve-${c.colour_index % 8}`), alpha: c.is_pale ? 0.45 : 1,
        width: c.dashed || c.is_pale ? 1.2 : 1.8, dash: c.dashed ? [5, 4] : undefined, spanGaps: false, points: { show: c.time.length < 3 },
      }))],
      cursor: {
        drag: { x: true, y: false, setScale: false }, points: { size: 6 },
        bind: { dblclick: () => () => page.setRange(), mouseleave: () => null },
        dataIdx: (u, series) => { const c = this.curves[series - 1]; return c ? this._joinedIndex(u.data[0], c, page.time) : u.posToIdx(u.cursor.left); },
      },
      hooks: {
        setCursor: [(u) => { if (!this.isSettingCursor && u.cursor.left >= 0) page.setTime(u.posToVal(u.cursor.left, "x"), this); }],
        setSelect: [(u) => { const { left, width } = u.select; if (width > 3) {
          page.setRange(u.posToVal(left, "x"), u.posToVal(left + width, "x")); }
          u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false); }],
        drawAxes: [(u) => this._drawBackground(u)],
      },
    }, this._joinCurves(), this.plotBox);
    const over = this.plot.over;
    over.addEventListener("pointermove", (e) => { if (e.pointerType === "touch") this._onTouch(e); });
    over.addEventListener("pointerdown", (e) => { if (e.pointerType === "touch") this._onTouch(e); });
    requestAnimationFrame(() => this.setTime(page.time));
  }

  /** Return the visible part of all curves with common times, as uPlot needs it. */
  _joinCurves() {
    const columns = Math.max(1, Math.round(this.plotBox.clientWidth * (window.devicePixelRatio || 1)));
    return uPlot.join(this.curves.map((c) => decimate(c.time, c.values, this.page.range, columns)));
  }

  _onTouch(e) {
    const box = this.plot.over.getBoundingClientRect();
    this.page.setTime(this.plot.posToVal(e.clientX - box.left, "x"), null);
  }

  _joinedIndex(times, curve, t) {
    if (!curve.time.length) return null;
    const nearestTime = curve.time[nearestIndex(curve.time, t)];
    return nearestIndex(times, nearestTime);
  }

  /** Return the range of the levels and limits that are near enough to the curves to be shown. */
  _findLevels() {
    let lower = Infinity, upper = -Infinity;
    for (const { values } of this.curves) for (const v of values) if (Number.isFinite(v)) { lower = Math.min(lower, v); upper = Math.max(upper, v); }
    const margin = 0.6 * Math.max(upper - lower, 1e-9);
    const near = [...this.panel.levels, ...this.panel.limits].map(([v]) => v)
      .filter((v) => v > lower - margin && v < upper + margin).concat(this.panel.span.filter((v) => v !== null));
    return [Math.min(Infinity, ...near), Math.max(-Infinity, ...near)];
  }

  _computeRange(lower, upper, low, high) {
    if (!Number.isFinite(lower)) return [-1, 1];
    lower = Math.min(lower, low); upper = Math.max(upper, high);
    const margin = Math.max((upper - lower) * GAP, 2e-3 * Math.abs(upper), 1e-9);
    return [lower - margin, upper + margin];
  }

  /** Draw the band, the levels, the limits and the marks behind the curves. */
  _drawBackground(u) {
    const { ctx, bbox } = u, { panel, page } = this, ratio = window.devicePixelRatio || 1;
    const line = (x0, y0, x1, y1, colour, dash) => {
      ctx.strokeStyle = page.colour(colour); ctx.setLineDash(dash.map((d) => d * ratio)); ctx.lineWidth = ratio;
      ctx.beginPath(); ctx.moveTo(x0, y0); ctx.lineTo(x1, y1); ctx.stroke();
    };
    ctx.save();
    ctx.beginPath(); ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height); ctx.clip();
    ctx.font = `${11 * ratio}px system-ui, "DejaVu Sans", sans-serif`;
    const right = bbox.left + bbox.width;
    if (panel.band !== null) {
      const top = u.valToPos(panel.band, "y", true), bottom = u.valToPos(-panel.band, "y", true);
      ctx.globalAlpha = 0.16; ctx.fillStyle = page.colour("good");
      ctx.fillRect(bbox.left, top, bbox.width, bottom - top); ctx.globalAlpha = 1;
    }
    if (!panel.is_logarithmic) { const y = u.valToPos(0, "y", true); line(bbox.left, y, right, y, "zero", []); }
    for (const [lines, shade] of [[panel.levels, "good"], [panel.limits, "bad"]]) {
      ctx.fillStyle = page.colour(shade); ctx.textAlign = "right";
      for (const [value, text] of lines) {
        const y = u.valToPos(value, "y", true);
        line(bbox.left, y, right, y, shade, [5, 3]);
        ctx.fillText(text, right - 4 * ratio, y - (y > bbox.top + 14 * ratio ? 3 : -12) * ratio);  // at the top, below the line
      }
    }
    for (const [time, text] of panel.marks) {
      const x = u.valToPos(time, "x", true), words = `${text} after ${time.toFixed(2)} s`;
      const left = x + 4 * ratio + ctx.measureText(words).width > right;
      line(x, bbox.top, x, bbox.top + bbox.height, "good", [2, 3]);
      ctx.fillStyle = page.colour("good"); ctx.textAlign = left ? "right" : "left";
      ctx.fillText(words, x + (left ? -4 : 4) * ratio, bbox.top + 12 * ratio);
    }
    ctx.restore();
  }

  setTime(t) {
    this.curves.forEach((curve, i) => {
      if (!curve.time.length) return;
      const v = curve.values[nearestIndex(curve.time, t)];
      const text = formatNumber(v);
      if (this.entries[i].value.textContent !== text) this.entries[i].value.textContent = text;
    });
    if (!this.plot) return;
    this.isSettingCursor = true;
    const left = this.plot.valToPos(t, "x");
    this.plot.setCursor({ left: left >= 0 && left <= this.plot.over.clientWidth ? left : -10, top: 10 });
    this.isSettingCursor = false;
  }

  setRange() {
    if (this.plot) {
      // uPlot reports the cursor again at the same pixel, which would move the time of the page.
      this.isSettingCursor = true;
      this.plot.setData(this._joinCurves(), false);
      this.plot.setScale("x", { min: this.page.range[0], max: this.page.range[1] });
    }
    requestAnimationFrame(() => this.setTime(this.page.time));
  }

  resize() {
    const width = this.plotBox.clientWidth, height = this.plotBox.clientHeight;
    if (this.plot && width && (width !== this.plot.width || height !== this.plot.height)) {
      this.plot.setSize({ width, height });
      this.setRange();
      return;
    }
    requestAnimationFrame(() => this.setTime(this.page.time));  // after the axes have their new layout
  }
}
