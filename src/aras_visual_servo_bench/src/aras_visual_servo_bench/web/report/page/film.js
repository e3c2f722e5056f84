// The film of one run, with what is drawn over it; frames are decoded when they are shown.

const KEPT_FRAMES = 48;
const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

class Film {
  constructor(canvas, caption, run, page, film = run.film) {
    Object.assign(this, { canvas, caption, run, page, film, kept: new Map(), wanted: -1 });
    this.time = page.array(this.film.time);
    const read = (i) => i === null ? null : page.array(i);
    this.rim = read(this.film.wanted);
    const tracks = this.film.tracks;
    this.tracks = tracks && { time: page.array(tracks.time), desired: page.array(tracks.desired),
      pixels: tracks.pixels.map(read), names: tracks.names, measured: tracks.measured };
  }

  index(t) { return near(this.time, t); }

  async picture(i) {
    if (!this.kept.has(i)) {
      if (this.kept.size >= KEPT_FRAMES) this.kept.delete(this.kept.keys().next().value);
      this.kept.set(i, createImageBitmap(new Blob([bytesOf(this.film.frames[i])], { type: "image/jpeg" })));
    }
    return this.kept.get(i);
  }

  async setTime(t) {
    const i = this.index(t);
    this.wanted = i; this.t = t;
    const bitmap = await this.picture(i);
    if (this.wanted === i) this.draw(bitmap, i);  // another is wanted by now
  }

  draw(bitmap, i) {
    const { canvas, film } = this, scale = window.devicePixelRatio || 1;
    const width = Math.max(1, Math.round(canvas.clientWidth * scale)), height = Math.round(width * film.height / film.width);
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const c = canvas.getContext("2d");
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.imageSmoothingEnabled = bitmap.width > width;
    c.drawImage(bitmap, 0, 0, width, height);
    if (this.page.overlay) this._over(c, width / film.width, scale);
    this.frame = i;
    this.caption.textContent = `${this.page.several ? `${this.run.name}: ` : ""}${this.film.camera ? `camera ${this.film.camera}, ` : ""}image ${i + 1} of ${this.time.length}, ${this.time[i].toFixed(3)} s`;
  }

  _over(c, k, scale) {
    c.setTransform(k, 0, 0, k, 0.5 * k, 0.5 * k);  // a pixel's middle has whole numbers
    const stroke = (points, from, to, closed) => {
      c.beginPath();
      let pen = false;
      for (let n = from; n < to; n++) {
        const x = points[2 * n], y = points[2 * n + 1];
        if (!Number.isFinite(x)) { pen = false; continue; }
        if (pen) c.lineTo(x, y); else c.moveTo(x, y);
        pen = true;
      }
      if (closed) c.closePath();
      c.stroke();
    };
    const rim = this.rim;
    c.lineWidth = 2 * scale / k; c.strokeStyle = this.page.goalColour;
    if (rim) stroke(rim, 0, rim.length / 2, true);
    if (!this.tracks) return;
    const now = near(this.tracks.time, this.t);
    this.tracks.pixels.forEach((points, n) => {
      const strong = this.tracks.measured || this.tracks.names[n].startsWith("centre");
      c.strokeStyle = c.fillStyle = this.page.dark[strong ? n % this.page.dark.length : 7];
      c.lineWidth = (strong ? 2 : 1.2) * scale / k;
      stroke(points, 0, now + 1, false);
      const x = points[2 * now], y = points[2 * now + 1];
      if (Number.isFinite(x)) { c.beginPath(); c.arc(x, y, (strong ? 4 : 3) * scale / k, 0, 7); c.fill(); }
      const [u, v] = this.tracks.desired.slice(2 * n, 2 * n + 2);
      if (!Number.isFinite(u)) return;
      c.strokeStyle = this.page.goalColour; c.lineWidth = 1.5 * scale / k;
      c.beginPath(); c.arc(u, v, (strong ? 6 : 4) * scale / k, 0, 7); c.stroke();
    });
  }
}

// The path in space: what stands still is drawn once, the cameras move with the cursor.
class Space {
  constructor(canvas, page) {
    this.page = page; this.told = page.contents.scene;
    this.scene = new Scene(canvas);
    const { middle, size } = this.told;
    this.scene.views.run = { middle, distance: 1.5 * size, yaw: 0.95, pitch: 0.36 };
    this.scene.setView("run");
    this.poses = page.contents.runs.map((run) => run.poses && { time: page.array(run.poses.time), rows: page.array(run.poses.rows),
      arm: run.poses.arm !== undefined ? page.array(run.poses.arm) : null, joints: run.poses.joints });
    this.setRuns();
  }

  setRuns() {
    const shapes = {};
    for (const [key, some] of Object.entries(this.told.shapes)) {
      if (this.page.off.has(+key)) continue;
      for (const [name, shape] of some) shapes[`${key} ${name}`] = shape;
    }
    this.scene.setShapes(shapes, true);
    this.setTime(this.page.time);
  }

  setTime(t) {
    const changed = {};
    this.poses.forEach((poses, k) => {
      if (!poses || this.page.off.has(k)) return;
      const i = near(poses.time, t), m = poses.rows.slice(12 * i, 12 * i + 12), rim = this.told.rims[k];
      const world = ([x, y, z]) => [0, 4, 8].map((r) => m[r] * x + m[r + 1] * y + m[r + 2] * z + m[r + 3]);
      const points = rim.map(world), here = world([0, 0, 0]), edges = [];
      for (const n of [0, 1, 2, 3]) if (points.length) edges.push(...here, ...points[n * points.length / 4]);
      const colour = this.told.colours[k], width = 0.006 * this.told.size;
      changed[`${k} camera edges`] = { kind: "lines", points: edges, colour, width };
      changed[`${k} camera rim`] = { kind: "strip", points: [...points, ...points.slice(0, 1)].flat(), colour, width };
      if (poses.arm) {  // joints and camera
        const length = 3 * poses.joints, places = poses.arm.slice(length * i, length * (i + 1));
        changed[`${k} arm`] = { kind: "strip", points: [...places, ...here], colour: [...this.told.arm, 0.8], width: 3 * width };
      }
      const tip = 0.16 * this.told.size;
      ["x", "y", "z"].forEach((axis, n) => {
        const shade = [0, 1, 2].map((j) => j === n ? 0.95 : 0.25);
        changed[`${k} camera ${axis}`] = { kind: "lines", colour: [...shade, 1], width: 2 * width,
          points: [...here, ...world([0, 1, 2].map((j) => j === n ? 0.5 * tip : 0))] };
      });
    });
    this.scene.setShapes(changed, false);
  }
}
