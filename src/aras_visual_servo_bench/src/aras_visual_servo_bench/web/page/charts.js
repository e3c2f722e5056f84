// Curves over time by uPlot: one cursor and one range of time for all of them.

const GAP = 0.04;  // part of a level's axis that stays free above and below
const near = (times, t) => {  // index of the entry next to t
  let low = 0, high = times.length - 1;
  while (high - low > 1) { const m = (low + high) >> 1; if (times[m] <= t) low = m; else high = m; }
  return Math.abs(times[high] - t) < Math.abs(times[low] - t) ? high : low;
};

export function told(v) {
  if (!Number.isFinite(v)) return "–";
  const size = Math.abs(v);
  if (size === 0) return "0";
  if (size < 1e-3 || size >= 1e5) return v.toExponential(2);
  return v.toPrecision(size >= 1000 ? 5 : 4);
}

export class Chart {
  /** `box`: where it goes; `panel`: of the contents; `page`: time, range, colours and runs for all. */
  constructor(box, panel, page) {
    Object.assign(this, { box, panel, page, hidden: new Set(), seen: false });
    this.curves = panel.curves.map((c) => ({ ...c, time: page.array(c.x), values: page.array(c.y) }));
    const title = document.createElement("h3");
    title.textContent = panel.title;
    this.plotBox = document.createElement("div");
    this.plotBox.className = "plot";
    this.legend = document.createElement("div");
    this.legend.className = "legend";
    box.append(title, this.plotBox, this.legend);
    if (panel.left_out) {
      const note = document.createElement("p");
      note.className = "left-out";
      note.textContent = `${this.curves.length} curves of ${this.curves.length + panel.left_out}: those `
        + "that change most. All of them are in the tables beside this page, in data/.";
      box.append(note);
    }
    this.entries = this.curves.map((curve, i) => this._entry(curve, i));
    this.legend.append(...this.entries.map((entry) => entry.button));
  }

  _entry(curve, i) {
    const button = document.createElement("button"), mark = document.createElement("i");
    const name = document.createElement("span"), value = document.createElement("output");
    mark.className = curve.dashed ? "dashed" : curve.pale ? "pale" : "";
    mark.style.setProperty("--shade", `var(--curve-${curve.shade % 8})`);
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

  shown(i) { return !this.hidden.has(i) && !this.page.off.has(this.curves[i].run); }

  _showCurves() {
    this.curves.forEach((curve, i) => {
      this.entries[i].button.hidden = this.page.off.has(curve.run);
      if (this.plot && this.plot.series[i + 1].show !== this.shown(i)) this.plot.setSeries(i + 1, { show: this.shown(i) });
    });
  }

  /** Draw it, now that somebody sees it; anew with other colours. */
  draw() {
    if (this.plot) this.plot.destroy();
    const { page, panel } = this, ink = page.colour("soft"), grid = { stroke: page.colour("line"), width: 1 };
    const join = uPlot.join(this.curves.map((c) => [c.time, Array.from(c.values, (v) => Number.isFinite(v) ? v : null)]));
    const tens = (u, splits) => splits.map((v) => !panel.log || Math.abs(Math.log10(v) % 1) < 1e-9 ? v : null);
    const font = '11px system-ui, "DejaVu Sans", sans-serif';
    const [low, high] = this._levels();
    this.plot = new uPlot({
      width: Math.max(this.plotBox.clientWidth, 120), height: this.plotBox.clientHeight,
      legend: { show: false },
      scales: {
        x: { time: false, range: () => page.range },
        y: panel.log ? { distr: 3 } : { range: (u, least, most) => this._range(least, most, low, high) },
      },
      axes: [
        { stroke: ink, grid, ticks: grid, font, size: 28, values: (u, at) => at.map((v) => `${+v.toPrecision(6)} s`) },
        { stroke: ink, grid: { ...grid, filter: tens }, ticks: { ...grid, filter: tens }, font, size: 58,
          values: (u, at) => at.map((v) => v === null ? null : Math.abs(v) >= 1e5 || (v && Math.abs(v) < 1e-3) ? v.toExponential(0) : String(+v.toPrecision(6))) },
      ],
      series: [{}, ...this.curves.map((c, i) => ({
        label: c.name, show: this.shown(i), stroke: page.colour(`curve-${c.shade % 8}`), alpha: c.pale ? 0.45 : 1,
        width: c.dashed || c.pale ? 1.2 : 1.8, dash: c.dashed ? [5, 4] : undefined, spanGaps: false, points: { show: c.time.length < 3 },
      }))],
      cursor: {
        drag: { x: true, y: false, setScale: false }, points: { size: 6 },
        bind: { dblclick: () => () => page.setRange(), mouseleave: () => null },
        dataIdx: (u, series) => { const c = this.curves[series - 1]; return c ? this._joined(join[0], c, page.time) : u.posToIdx(u.cursor.left); },
      },
      hooks: {
        setCursor: [(u) => { if (!this.moving && u.cursor.left >= 0) page.setTime(u.posToVal(u.cursor.left, "x"), this); }],
        setSelect: [(u) => { const { left, width } = u.select; if (width > 3) {
          page.setRange(u.posToVal(left, "x"), u.posToVal(left + width, "x")); }
          u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false); }],
        drawAxes: [(u) => this._behind(u)],
      },
    }, join, this.plotBox);
    const over = this.plot.over;
    over.addEventListener("pointermove", (e) => { if (e.pointerType === "touch") this._touched(e); });
    over.addEventListener("pointerdown", (e) => { if (e.pointerType === "touch") this._touched(e); });
    requestAnimationFrame(() => this.setTime(page.time));
  }

  _touched(e) {
    const box = this.plot.over.getBoundingClientRect();
    this.page.setTime(this.plot.posToVal(e.clientX - box.left, "x"), null);
  }

  _joined(times, curve, t) {
    if (!curve.time.length) return null;
    const wanted = curve.time[near(curve.time, t)];
    return near(times, wanted);
  }

  /** Levels and bands that are near enough to be shown. */
  _levels() {
    let least = Infinity, most = -Infinity;
    for (const { values } of this.curves) for (const v of values) if (Number.isFinite(v)) { least = Math.min(least, v); most = Math.max(most, v); }
    const room = 0.6 * Math.max(most - least, 1e-9);
    const near = [...this.panel.levels, ...this.panel.limits].map(([v]) => v)
      .filter((v) => v > least - room && v < most + room).concat(this.panel.span.filter((v) => v !== null));
    return [Math.min(Infinity, ...near), Math.max(-Infinity, ...near)];
  }

  _range(least, most, low, high) {
    if (!Number.isFinite(least)) return [-1, 1];
    least = Math.min(least, low); most = Math.max(most, high);
    const room = Math.max((most - least) * GAP, 2e-3 * Math.abs(most), 1e-9);
    return [least - room, most + room];
  }

  /** Bands, levels and marks, behind the curves. */
  _behind(u) {
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
    if (!panel.log) { const y = u.valToPos(0, "y", true); line(bbox.left, y, right, y, "zero", []); }
    for (const [lines, shade] of [[panel.levels, "good"], [panel.limits, "bad"]]) {
      ctx.fillStyle = page.colour(shade); ctx.textAlign = "right";
      for (const [value, text] of lines) {
        const y = u.valToPos(value, "y", true);
        line(bbox.left, y, right, y, shade, [5, 3]);
        ctx.fillText(text, right - 4 * ratio, y - 3 * ratio);
      }
    }
    for (const [time, text] of panel.marks) {
      const x = u.valToPos(time, "x", true), left = x > bbox.left + 0.75 * bbox.width;
      line(x, bbox.top, x, bbox.top + bbox.height, "good", [2, 3]);
      ctx.fillStyle = page.colour("good"); ctx.textAlign = left ? "right" : "left";
      ctx.fillText(`${text} after ${time.toFixed(2)} s`, x + (left ? -4 : 4) * ratio, bbox.top + 12 * ratio);
    }
    ctx.restore();
  }

  setTime(t) {
    this.curves.forEach((curve, i) => {
      if (!curve.time.length) return;
      const v = curve.values[near(curve.time, t)];
      const text = told(v);
      if (this.entries[i].value.textContent !== text) this.entries[i].value.textContent = text;
    });
    if (!this.plot) return;
    this.moving = true;
    const left = this.plot.valToPos(t, "x");
    this.plot.setCursor({ left: left >= 0 && left <= this.plot.over.clientWidth ? left : -10, top: 10 });
    this.moving = false;
  }

  setRange() {
    if (this.plot) this.plot.setScale("x", { min: this.page.range[0], max: this.page.range[1] });
    requestAnimationFrame(() => this.setTime(this.page.time));
  }

  resize() {
    const width = this.plotBox.clientWidth, height = this.plotBox.clientHeight;
    if (this.plot && width && (width !== this.plot.width || height !== this.plot.height)) this.plot.setSize({ width, height });
    requestAnimationFrame(() => this.setTime(this.page.time));  // its axes are laid out then
  }
}
