// The part of the 3-D scene that stays inside its view: the robot or its hand, the target, the camera and its goal.

import { HALF_ANGLE, boundingBox } from "./scene.js";

// The view has room for a sphere SPARE times as large as its content. It is fitted again if the content leaves this
// sphere, or is smaller than the sphere by the factor MAX_SPARE.
const SPARE = 1.1, MAX_SPARE = 2.5, MIN_RADIUS = 0.05;  // the last in m
const HAND_LINKS = 3;  // number of links next to the camera that belong to the hand
const DIRECTIONS = { all: { yaw: 0.75, pitch: 0.38 }, run: { yaw: 0.95, pitch: 0.36 } };

const boxes = new WeakMap();  // bounding box of each shape
const shapeBox = (shape) => {
  if (!boxes.has(shape)) boxes.set(shape, boundingBox(shape.points, 3));
  return boxes.get(shape);
};

/** Return the names of the last drawn links of the chain that ends at the camera; all drawn links if there is no camera. */
function handLinks(scene) {
  const drawn = new Set(scene.meshes.map((mesh) => mesh.link)), axis = scene.shapes["camera x"];
  if (!axis || !scene.robot) return drawn;
  const camera = axis.points.slice(0, 3);
  const distance = (link) => { const m = scene.poses[link]; return Math.hypot(m[3] - camera[0], m[7] - camera[1], m[11] - camera[2]); };
  const parents = Object.fromEntries(scene.robot.joints.map((joint) => [joint.child, joint.parent])), found = new Set();
  let link = Object.keys(scene.poses).reduce((a, b) => distance(b) < distance(a) ? b : a);
  for (; link !== undefined && found.size < HAND_LINKS; link = parents[link]) if (drawn.has(link)) found.add(link);
  return found;
}

/** Return the sphere around all shapes and some links: {middle, radius} in the base frame, m; null if nothing is drawn. */
function boundingSphere(scene, links) {
  const found = Object.values(scene.shapes).map(shapeBox);
  for (const { link, box } of scene.meshes) {
    const m = scene.poses[link];
    if (!links.has(link) || !m) continue;
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].flatMap((k) => {
      const p = [0, 1, 2].map((i) => box[(k >> i) & 1][i]);
      return [0, 4, 8].map((r) => m[r] * p[0] + m[r + 1] * p[1] + m[r + 2] * p[2] + m[r + 3]);
    });
    found.push(boundingBox(corners, 3));
  }
  if (!found.length) return null;
  const low = [0, 1, 2].map((i) => Math.min(...found.map((box) => box[0][i])));
  const high = [0, 1, 2].map((i) => Math.max(...found.map((box) => box[1][i])));
  return { middle: low.map((v, i) => (v + high[i]) / 2), radius: Math.hypot(...low.map((v, i) => high[i] - v)) / 2 };
}

/** Keep the whole robot ("all") or its hand ("run"), and all shapes, inside the view, until the user moves the view. */
export function follow(scene, what) {
  let frame = null;
  scene.setView({ middle: [0, 0, 0], distance: 2, ...DIRECTIONS[what] });
  scene.fitView = (aspect) => {
    const links = what === "run" ? handLinks(scene) : new Set(scene.meshes.map((mesh) => mesh.link));
    const content = boundingSphere(scene, links);
    if (!content) return;
    const radius = Math.max(MIN_RADIUS, content.radius);
    if (frame && frame.aspect === aspect && frame.radius < MAX_SPARE * radius
      && Math.hypot(...content.middle.map((v, i) => v - frame.middle[i])) + content.radius <= frame.radius) return;
    frame = { middle: content.middle, radius: SPARE * radius, aspect };
    const half = Math.min(HALF_ANGLE, Math.atan(Math.tan(HALF_ANGLE) * aspect));
    Object.assign(scene.view, { middle: frame.middle, distance: frame.radius / Math.sin(half) });
  };
}
