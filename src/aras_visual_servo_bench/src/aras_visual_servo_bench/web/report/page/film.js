// The images of one run as a film with an overlay. An image is decoded when it is shown.

const CACHED_FRAMES = 48;
function decodeBytes(text) {  // a loop takes a tenth of the time of Uint8Array.from with a function
  const plain = atob(text), bytes = new Uint8Array(plain.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = plain.charCodeAt(i);
  return bytes;
}

class Film {
  constructor(canvas, caption, run, page, film = run.film) {
    Object.assign(this, { canvas, caption, run, page, film, cache: new Map(), requestedFrame: -1 });
    this.time = page.array(this.film.time);
    const read = (i) => i === null ? null : page.array(i);
    this.desiredOutline = read(this.film.desired_outline);
    const tracks = this.film.tracks;
    this.tracks = tracks && { time: page.array(tracks.time), desired: page.array(tracks.desired),
      pixels: tracks.pixels.map(read), names: tracks.names, is_measured: tracks.is_measured };
  }

  frameIndex(t) { return nearestIndex(this.time, t); }

  async decodeFrame(i) {
    if (!this.cache.has(i)) {
      if (this.cache.size >= CACHED_FRAMES) this.cache.delete(this.cache.keys().next().value);
      this.cache.set(i, createImageBitmap(new Blob([decodeBytes(this.film.frames[i])], { type: "image/jpeg" })));
    }
    return this.cache.get(i);
  }

  async setTime(t) {
    const i = this.frameIndex(t);
    this.requestedFrame = i; this.t = t;
    const bitmap = await this.decodeFrame(i);
    if (this.requestedFrame === i) this.draw(bitmap, i);  // draw only the image that was requested last
  }

  draw(bitmap, i) {
    const { canvas, film } = this, scale = window.devicePixelRatio || 1;
    const width = Math.max(1, Math.round(canvas.clientWidth * scale)), height = Math.round(width * film.height / film.width);
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const c = canvas.getContext("2d");
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.imageSmoothingEnabled = bitmap.width > width;
    c.drawImage(bitmap, 0, 0, width, height);
    if (this.page.overlay) this._drawOverlay(c, width / film.width, scale);
    this.frame = i;
    this.caption.textContent = `${this.page.several ? `${this.run.name}: ` : ""}${this.film.camera ? `camera ${this.film.camera}, ` : ""}image ${i + 1} of ${this.time.length}, ${this.time[i].toFixed(3)} s`;
  }

  _drawOverlay(c, k, scale) {
    c.setTransform(k, 0, 0, k, 0.5 * k, 0.5 * k);  // pixel centres have integer coordinates
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
    const outline = this.desiredOutline;
    c.lineWidth = 2 * scale / k; c.strokeStyle = this.page.goalColour;
    if (outline) stroke(outline, 0, outline.length / 2, true);
    if (!this.tracks) return;
    const now = nearestIndex(this.tracks.time, this.t);
    this.tracks.pixels.forEach((points, n) => {
      const strong = this.tracks.is_measured || this.tracks.names[n].startsWith("centre");
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

// The camera paths in 3-D. Cameras and arms are drawn at the time of the cursor; other shapes do not change.
class Space {
  constructor(canvas, page) {
    this.page = page; this.contents = page.contents.scene;
    this.scene = new Scene(canvas);
    const { middle, size } = this.contents;
    this.scene.setView({ middle, distance: 2 * size, yaw: 0.95, pitch: 0.36 });
    this.scene.fitView = (aspect) => {  // the sphere around the scene and its cameras stays inside the view
      const half = Math.min(HALF_ANGLE, Math.atan(Math.tan(HALF_ANGLE) * aspect));
      this.scene.view.distance = (0.5 + this.contents.camera_size) * size / Math.sin(half);
    };
    this.poses = page.contents.runs.map((run) => run.poses && { time: page.array(run.poses.time), rows: page.array(run.poses.rows),
      arm: run.poses.arm !== undefined ? page.array(run.poses.arm) : null, joints: run.poses.joints });
    this.setRuns();
  }

  setRuns() {
    const shapes = {};
    for (const [key, some] of Object.entries(this.contents.shapes)) {
      if (this.page.hiddenRuns.has(+key)) continue;
      for (const [name, shape] of some) shapes[`${key} ${name}`] = shape;
    }
    this.scene.setShapes(shapes, true);
    this.setTime(this.page.time);
  }

  setTime(t) {
    const changed = {};
    this.poses.forEach((poses, k) => {
      if (!poses || this.page.hiddenRuns.has(k)) return;
      const i = nearestIndex(poses.time, t), m = poses.rows.slice(12 * i, 12 * i + 12), rim = this.contents.rims[k];
      const world = ([x, y, z]) => [0, 4, 8].map((r) => m[r] * x + m[r + 1] * y + m[r + 2] * z + m[r + 3]);
      const points = rim.map(world), centre = world([0, 0, 0]), edges = [];
      for (const n of [0, 1, 2, 3]) if (points.length) edges.push(...centre, ...points[n * points.length / 4]);
      const colour = this.contents.colours[k], width = 0.006 * this.contents.size;
      changed[`${k} camera edges`] = { kind: "lines", points: edges, colour, width };
      changed[`${k} camera rim`] = { kind: "strip", points: [...points, ...points.slice(0, 1)].flat(), colour, width };
      if (poses.arm) {  // draw a line through the origins of the joints to the camera
        const length = 3 * poses.joints, joints = poses.arm.slice(length * i, length * (i + 1));
        changed[`${k} arm`] = { kind: "strip", points: [...joints, ...centre], colour: [...this.contents.arm, 0.8], width: 3 * width };
      }
      const tip = 0.16 * this.contents.size;
      ["x", "y", "z"].forEach((axis, n) => {
        const axisColour = [0, 1, 2].map((j) => j === n ? 0.95 : 0.25);
        changed[`${k} camera ${axis}`] = { kind: "lines", colour: [...axisColour, 1], width: 2 * width,
          points: [...centre, ...world([0, 1, 2].map((j) => j === n ? 0.5 * tip : 0))] };
      });
    });
    this.scene.setShapes(changed, false);
  }
}
