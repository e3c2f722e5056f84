// The 3-D scene of a robot and the shapes of its run. WebGL draws it when something has changed.

const VERTEX = `
attribute vec3 place; attribute vec3 normal;
uniform mat4 model, view; uniform vec4 colour;
varying vec4 tone;
void main() {
  vec3 n = normalize(mat3(model) * normal);
  float light = 0.32 + 0.34 * max(dot(n, normalize(vec3(0.5, 0.35, 0.85))), 0.0)
    + 0.18 * max(dot(n, normalize(vec3(-0.6, -0.5, 0.3))), 0.0);
  tone = vec4(colour.rgb * light, colour.a);
  gl_Position = view * model * vec4(place, 1.0);
}`;
// A line is drawn as a ribbon of constant width in pixels.
const LINE_VERTEX = `
attribute vec3 here, there; attribute float side;
uniform mat4 view; uniform vec2 size; uniform float width; uniform vec4 colour;
varying vec4 tone;
void main() {
  vec4 a = view * vec4(here, 1.0), b = view * vec4(there, 1.0);
  vec2 direction = (b.xy / max(b.w, 0.01) - a.xy / max(a.w, 0.01)) * size;
  float far = length(direction);
  vec2 across = far > 1e-6 ? vec2(-direction.y, direction.x) / far : vec2(0.0);
  gl_Position = a + vec4(across * side * width / size * a.w, -0.0005 * a.w, 0.0);
  tone = colour;
}`;
// Time of a drawing above which a pause follows, and time above which several drawings in sequence reduce the
// resolution, ms.
const REST_THRESHOLD = 40, SLOW = 120;
// Length of the pause after a drawing divided by the time of the drawing, and longest pause, ms.
const REST_FACTOR = 3, MAX_REST = 1000;
const MOTION_TOLERANCE = 1e-4;  // smallest motion of a joint that is drawn, rad or m
export const HALF_ANGLE = 0.39;  // half of the vertical angle of view, rad
const sleep = (time) => new Promise((resolve) => setTimeout(resolve, time));
const FRAGMENT = "precision mediump float; varying vec4 tone; void main() { gl_FragColor = tone; }";

const multiply = (a, b) => {  // 4 x 4 matrices, row-major
  const c = new Array(16);
  for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) {
    c[4 * i + j] = a[4 * i] * b[j] + a[4 * i + 1] * b[4 + j] + a[4 * i + 2] * b[8 + j] + a[4 * i + 3] * b[12 + j];
  }
  return c;
};
const columns = (m) => new Float32Array([0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15].map((i) => m[i]));
const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
const minus = (a, b) => a.map((v, i) => v - b[i]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const unit = (a) => { const n = Math.hypot(...a) || 1; return a.map((v) => v / n); };

/** Return the smallest and the largest coordinates of points; each has `stride` numbers, of which x, y, z are the first. */
export function boundingBox(numbers, stride) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k + 2 < numbers.length; k += stride) {
    for (let i = 0; i < 3; i++) { low[i] = Math.min(low[i], numbers[k + i]); high[i] = Math.max(high[i], numbers[k + i]); }
  }
  return [low, high];
}

/** Return the transform parent_T_child of a joint at a position. */
export function jointTransform(joint, position) {
  const [x, y, z] = joint.axis;
  let motion = IDENTITY;
  if (joint.kind === "prismatic") {
    motion = [1, 0, 0, x * position, 0, 1, 0, y * position, 0, 0, 1, z * position, 0, 0, 0, 1];
  } else if (joint.kind === "revolute" || joint.kind === "continuous") {
    const c = Math.cos(position), s = Math.sin(position), k = 1 - c;
    motion = [c + x * x * k, x * y * k - z * s, x * z * k + y * s, 0,
      y * x * k + z * s, c + y * y * k, y * z * k - x * s, 0,
      z * x * k - y * s, z * y * k + x * s, c + z * z * k, 0, 0, 0, 0, 1];
  }
  return multiply(joint.origin, motion);
}

/** Return the pose base_T_link of each link; `positions` are the joint positions by name. */
export function linkPoses(robot, positions) {
  const poses = { [robot.root]: IDENTITY }, left = [...robot.joints];
  for (let round = 0; left.length && round <= robot.joints.length; round++) {
    for (let i = left.length - 1; i >= 0; i--) {
      const joint = left[i];
      if (!(joint.parent in poses)) continue;
      poses[joint.child] = multiply(poses[joint.parent], jointTransform(joint, positions[joint.name] || 0));
      left.splice(i, 1);
    }
  }
  return poses;
}

export class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.robot = null; this.meshes = []; this.poses = {}; this.lastPositions = {};
    this.shapes = {}; this.lines = {};
    this.view = { middle: [0, 0, 0], distance: 2, yaw: 0.95, pitch: 0.36 };
    this.fitView = null;  // function that changes the view before a drawing, until the user moves the view
    this.maxPixelRatio = 2;
    this.slowDrawings = 0;  // number of successive slow drawings
    this.isDrawRequested = this.isDrawing = false;
    const given = { antialias: true, preserveDrawingBuffer: true };
    const gl = canvas.getContext("webgl2", given) || canvas.getContext("webgl", given);
    if (!gl) throw new Error("this browser has no WebGL: the scene cannot be drawn; the rest of the page works");
    this.gl = gl;
    gl.getExtension("OES_element_index_uint");
    this.solid = this._makeProgram(VERTEX);
    this.ribbon = this._makeProgram(LINE_VERTEX);
    this.grid = this._lineBuffer(this._gridPoints(), true);
    canvas.addEventListener("webglcontextlost", (e) => { e.preventDefault(); this.isContextLost = true; });
    canvas.addEventListener("webglcontextrestored", () => location.reload());
    this._addListeners();
    new ResizeObserver(() => this.requestDraw()).observe(canvas);
    this.requestDraw();
  }

  setView(view) { Object.assign(this, { view, fitView: null }); this.requestDraw(); }

  setRobot(robot) {
    const gl = this.gl;
    for (const mesh of this.meshes) gl.deleteBuffer(mesh.buffer);
    this.robot = robot; this.meshes = []; this.poses = {}; this.lastPositions = {};
    for (const [link, parts] of Object.entries(robot.links)) {
      for (const part of parts) {
        const bytes = Uint8Array.from(atob(part.corners), (c) => c.charCodeAt(0));
        const buffer = gl.createBuffer();
        gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
        gl.bufferData(gl.ARRAY_BUFFER, bytes, gl.STATIC_DRAW);
        const box = boundingBox(new Float32Array(bytes.buffer), 6);
        this.meshes.push({ link, buffer, box, count: bytes.length / 24, colour: part.colour });
      }
    }
    this.setJoints({});
  }

  setJoints(positions) {
    if (!this.robot) return;
    const moved = Object.entries(positions).some(([name, q]) => !(Math.abs(q - this.lastPositions[name]) < MOTION_TOLERANCE));
    if (!moved && Object.keys(this.poses).length) return;
    this.lastPositions = positions;
    this.poses = linkPoses(this.robot, positions);
    this.requestDraw();
  }

  setShapes(changed, isFull) {
    if (isFull) for (const name of Object.keys(this.shapes)) if (!(name in changed)) this._removeLine(name);
    for (const [name, shape] of Object.entries(changed)) {
      if (!shape || !shape.points.length) { this._removeLine(name); continue; }
      this._freeBuffers(name);  // the shape keeps its place in the order of drawing
      this.shapes[name] = shape;
      if (shape.kind === "faces") { this.lines[name] = { solid: this._makeFaces(shape.points) }; continue; }
      this.lines[name] = this._lineBuffer(shape.points, shape.kind === "lines");
      if (shape.kind === "arrow") this.lines[name].solid = this._makeCone(shape);
    }
    this.requestDraw();
  }

  _removeLine(name) {
    this._freeBuffers(name);
    delete this.lines[name]; delete this.shapes[name];
  }

  _freeBuffers(name) {
    const { buffer, solid } = this.lines[name] || {};
    if (buffer) this.gl.deleteBuffer(buffer);
    if (solid) this.gl.deleteBuffer(solid.buffer);
  }

  _gridPoints() {
    const points = [], reach = 3, step = 0.5;
    for (let v = -reach; v <= reach + 1e-9; v += step) {
      points.push(v, -reach, 0, v, reach, 0, -reach, v, 0, reach, v, 0);
    }
    return points;
  }

  _lineBuffer(points, pairs) {
    const rows = [], count = points.length / 3;
    for (let i = 0; i + 1 < count; i += pairs ? 2 : 1) {
      const a = points.slice(3 * i, 3 * i + 3), b = points.slice(3 * i + 3, 3 * i + 6);
      // Two triangles. At the end of the line, the direction is reversed, so the sides are exchanged.
      rows.push(...a, ...b, 1, ...a, ...b, -1, ...b, ...a, -1, ...b, ...a, -1, ...a, ...b, -1, ...b, ...a, 1);
    }
    const gl = this.gl, buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(rows), gl.STATIC_DRAW);
    return { buffer, count: rows.length / 7 };
  }

  _makeCone(shape) {
    const tail = shape.points.slice(0, 3), tip = shape.points.slice(3, 6);
    const direction = unit(minus(tip, tail)), radius = 1.4 * shape.width, long = 4 * shape.width;
    const u = unit(cross(direction, Math.abs(direction[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0])), v = cross(direction, u);
    const ring = (k) => {
      const a = 2 * Math.PI * k / 12, n = [0, 1, 2].map((i) => Math.cos(a) * u[i] + Math.sin(a) * v[i]);
      return { n, p: [0, 1, 2].map((i) => tip[i] + radius * n[i]) };
    };
    const top = [0, 1, 2].map((i) => tip[i] + long * direction[i]), rows = [];
    for (let k = 0; k < 12; k++) {
      const a = ring(k), b = ring(k + 1), down = direction.map((w) => -w);
      rows.push(...a.p, ...a.n, ...b.p, ...b.n, ...top, ...a.n, ...a.p, ...down, ...tip, ...down, ...b.p, ...down);
    }
    return this._solidBuffer(rows);
  }

  /** Make a buffer of the triangles of a shape; each triangle has its own normal. */
  _makeFaces(points) {
    const rows = [];
    for (let i = 0; i + 8 < points.length; i += 9) {
      const corners = [0, 3, 6].map((k) => points.slice(i + k, i + k + 3));
      const normal = unit(cross(minus(corners[1], corners[0]), minus(corners[2], corners[0])));
      for (const corner of corners) rows.push(...corner, ...normal);
    }
    return this._solidBuffer(rows);
  }

  _solidBuffer(rows) {
    const gl = this.gl, buffer = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(rows), gl.STATIC_DRAW);
    return { buffer, count: rows.length / 6 };
  }

  _makeProgram(vertex) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    const places = {};
    for (const name of ["model", "view", "colour", "size", "width"]) places[name] = gl.getUniformLocation(program, name);
    for (const name of ["place", "normal", "here", "there", "side"]) places[name] = gl.getAttribLocation(program, name);
    return { program, ...places };
  }

  /** Draw at the next animation frame. A hidden page has no animation frames, so it is not drawn. */
  requestDraw() {
    this.isDrawRequested = true;
    if (!this.isDrawing) this._drawLoop();
  }

  /** Draw as long as drawings are requested. A drawing starts after the previous one has finished. */
  async _drawLoop() {
    this.isDrawing = true;
    try {
      while (this.isDrawRequested && !this.isContextLost) {
        await new Promise(requestAnimationFrame);
        this.isDrawRequested = false;
        const start = performance.now();
        this.draw();
        await this._waitForDraw(start);
        const took = performance.now() - start;
        // If there is no graphics card, a lower resolution keeps the page responsive, and the pauses leave
        // processor time for the simulator.
        this.slowDrawings = took > SLOW ? this.slowDrawings + 1 : 0;
        if (this.slowDrawings > 8 && this.maxPixelRatio > 0.5) { this.maxPixelRatio *= 0.75; this.slowDrawings = 0; }
        if (took > REST_THRESHOLD) await sleep(Math.min(REST_FACTOR * took, MAX_REST));
      }
    } finally { this.isDrawing = false; }
  }

  /** Wait until the graphics card or its software replacement has finished the drawing. */
  async _waitForDraw(start) {
    const gl = this.gl;
    if (!gl.fenceSync) return;  // WebGL 1 has no fences
    const fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    while (fence && !gl.isContextLost() && performance.now() - start < 10 * MAX_REST
      && gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED) await sleep(4);
    gl.deleteSync(fence);
  }

  _cameraPosition() {
    const { middle, distance, yaw, pitch } = this.view;
    const back = [Math.cos(pitch) * Math.cos(yaw), Math.cos(pitch) * Math.sin(yaw), Math.sin(pitch)];
    return { back, position: middle.map((m, i) => m + distance * back[i]) };
  }

  /** Return the matrix (4, 4) that projects world coordinates onto the canvas, row by row. */
  computeProjection() {
    const { back, position } = this._cameraPosition(), right = unit(cross([0, 0, 1], back)), up = cross(back, right);
    const look = [...right, -dot(right, position), ...up, -dot(up, position), ...back, -dot(back, position), 0, 0, 0, 1];
    const f = 1 / Math.tan(HALF_ANGLE), near = 0.02, far = 40, aspect = this.canvas.width / this.canvas.height;
    return multiply([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), 2 * far * near / (near - far),
      0, 0, -1, 0], look);
  }

  draw() {
    const gl = this.gl, canvas = this.canvas, scale = Math.min(window.devicePixelRatio || 1, this.maxPixelRatio);
    const width = Math.max(1, Math.round(canvas.clientWidth * scale)), height = Math.max(1, Math.round(canvas.clientHeight * scale));
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    if (this.fitView) this.fitView(width / height);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.105, 0.125, 0.165, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    const view = columns(this.computeProjection());
    gl.useProgram(this.solid.program);
    gl.uniformMatrix4fv(this.solid.view, false, view);
    for (const mesh of this.meshes) this._triangles(mesh, columns(this.poses[mesh.link] || IDENTITY), mesh.colour);
    for (const [name, line] of Object.entries(this.lines)) {
      if (line.solid) this._triangles(line.solid, columns(IDENTITY), this.shapes[name].colour);
    }
    gl.useProgram(this.ribbon.program);
    gl.uniformMatrix4fv(this.ribbon.view, false, view);
    gl.uniform2f(this.ribbon.size, width, height);
    gl.depthMask(false);  // of lines at the same place, such as two cameras, the last one is visible in its whole length
    this._ribbon(this.grid, [0.45, 0.5, 0.6, 0.28], scale);
    for (const [name, line] of Object.entries(this.lines)) {
      if (!line.buffer) continue;
      const shape = this.shapes[name];
      const pixels = Math.min(5, Math.max(1.2, 0.75 * shape.width / this.view.distance * 1100));
      this._ribbon(line, shape.colour, pixels * scale);
    }
    gl.depthMask(true);  // which clearing needs
    // WebGL does not draw while an enabled array is in a deleted buffer.
    for (const name of ["here", "there", "side"]) gl.disableVertexAttribArray(this.ribbon[name]);
    for (const name of ["place", "normal"]) gl.disableVertexAttribArray(this.solid[name]);
  }

  _triangles(mesh, model, colour) {
    const gl = this.gl, p = this.solid;
    gl.uniformMatrix4fv(p.model, false, model);
    // Black is made lighter, because shading is invisible on black.
    gl.uniform4f(p.colour, ...colour.slice(0, 3).map((c) => 0.04 + 0.96 * c), colour[3]);
    gl.bindBuffer(gl.ARRAY_BUFFER, mesh.buffer);
    gl.enableVertexAttribArray(p.place);
    gl.vertexAttribPointer(p.place, 3, gl.FLOAT, false, 24, 0);
    gl.enableVertexAttribArray(p.normal);
    gl.vertexAttribPointer(p.normal, 3, gl.FLOAT, false, 24, 12);
    gl.drawArrays(gl.TRIANGLES, 0, mesh.count);
  }

  _ribbon(line, colour, pixels) {
    const gl = this.gl, p = this.ribbon;
    gl.uniform4f(p.colour, ...colour);
    gl.uniform1f(p.width, pixels);
    gl.bindBuffer(gl.ARRAY_BUFFER, line.buffer);
    for (const [name, size, offset] of [["here", 3, 0], ["there", 3, 12], ["side", 1, 24]]) {
      gl.enableVertexAttribArray(p[name]);
      gl.vertexAttribPointer(p[name], size, gl.FLOAT, false, 28, offset);
    }
    gl.drawArrays(gl.TRIANGLES, 0, line.count);
  }

  _addListeners() {
    const canvas = this.canvas;
    let pointer = null;
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("pointerdown", (e) => {
      pointer = { x: e.clientX, y: e.clientY, move: e.button !== 0 || e.shiftKey };
      canvas.setPointerCapture(e.pointerId);
    });
    canvas.addEventListener("pointerup", () => { pointer = null; });
    canvas.addEventListener("pointercancel", () => { pointer = null; });
    canvas.addEventListener("pointermove", (e) => {
      if (!pointer) return;
      const dx = e.clientX - pointer.x, dy = e.clientY - pointer.y, view = this.view;
      pointer.x = e.clientX; pointer.y = e.clientY;
      this.fitView = null;
      if (pointer.move) {
        const { back } = this._cameraPosition(), right = unit(cross([0, 0, 1], back)), up = cross(back, right);
        const k = 0.82 * view.distance / canvas.clientHeight;
        view.middle = view.middle.map((m, i) => m - k * dx * right[i] + k * dy * up[i]);
      } else {
        view.yaw -= 0.008 * dx;
        view.pitch = Math.min(1.55, Math.max(-0.6, view.pitch + 0.008 * dy));
      }
      this.requestDraw();
    });
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.fitView = null;
      this.view.distance = Math.min(15, Math.max(0.15, this.view.distance * Math.exp(0.001 * e.deltaY)));
      this.requestDraw();
    }, { passive: false });
  }
}
