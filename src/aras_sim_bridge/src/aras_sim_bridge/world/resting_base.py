"""Bases that are not bolted down but stand still all the same.

The original's robot weighs 1.7 t and stands on the floor. Contacts of twelve corners in each step
cost five times what the arm does, and all they say is that the base does not move. So a free model
that rests on what never moves is stepped as if it were bolted down, as ODE puts resting bodies to
sleep; but after every step the floor is asked whether it can bear what the arm, and whatever lies
on the model or strikes it, asks of the base: by pressure within its corners, and by friction. When
it cannot, or somebody pushes, moves or changes anything, the base is free again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import cv2
import numpy as np

from aras_sim_bridge.description import Geometry, shapes
from aras_sim_bridge.world.body import LINK_MARGIN
from aras_sim_bridge.world.bullet import find_contacts, pybullet
from aras_sim_bridge.world.model import Model
from aras_visual_servo_base.compiled import jit
from aras_visual_servo_base.poses import Pose, Twist, rotate

CHECK_EVERY = 50  # steps
RETRY_STEPS = 1000  # steps after which a base that the floor could not hold is looked at again
_REST_TOLERANCE = 1e-6  # m and rad between two looks
_CONTACT_DISTANCE = 1e-4  # m; Bullet lets what rests sink in by a tenth of it
_LOAD_LIMIT = 0.9  # of what friction and corners can bear
_SMALLEST_LEVER = 0.05  # of the distance to an axle, at which a joint still gives way to a contact
# What strikes a base finds it bolted for a step, and rebounds as from a wall: off by the share that
# its mass has of the base's. So a base is held only where that is so much heavier.
_LEAST_MASS_RATIO = 100.0


BASE_TYPES = "f8[::1], f8[::1], f8[:,::1], f8[::1], f8[::1]"
# Of a base that is bolted down.
FIXED_BASE_ARRAYS = (np.zeros(11), np.zeros((1, 6)), np.zeros(6), np.zeros(6))


@jit("i8[:,::1], f8[:,::1], f8[:,::1], f8[::1], f8[::1], f8[::1], f8[:,::1], f8[::1], "
          "f8[::1], f8", allocates=False)
def is_supported(
    tree,
    frames,
    state,
    previous_speeds,
    gravity,
    ground,
    corners,
    contact_wrench,
    ground_wrench,
    dt,
):
    """Whether the ground can bear a bolted tree's base over the step that was just made.

    tree, frames, state: of joint_dynamics.py, after the step. before (n,): speeds before it.
    gravity (3,): m/s². ground (11,): mass and centre of mass of the base, the ground's normal, a
    point of the ground, friction coefficient. corners (m, 6): of a polygon on the ground, each
    with the outward normal of the edge that begins there. touch (6,): torque and force of what
    touches the model. All in the root's axes, about its origin. load (6,): gets torque and force
    that the ground and the base's weight must give.
    """
    for k in range(6):
        ground_wrench[k] = -contact_wrench[k]
    for j in range(len(tree)):
        f = frames[j]
        a = (state[1, j] - previous_speeds[j]) / dt
        sx, sy, sz, tx, ty, tz = f[12] * a, f[13] * a, f[14] * a, f[15] * a, f[16] * a, f[17] * a
        m, hx, hy, hz = f[30], f[31], f[32], f[33]
        ground_wrench[0] += f[34] * sx + f[35] * sy + f[36] * sz + hy * tz - hz * ty
        ground_wrench[1] += f[35] * sx + f[37] * sy + f[38] * sz + hz * tx - hx * tz
        ground_wrench[2] += f[36] * sx + f[38] * sy + f[39] * sz + hx * ty - hy * tx
        ground_wrench[3] += m * tx + sy * hz - sz * hy
        ground_wrench[4] += m * ty + sz * hx - sx * hz
        ground_wrench[5] += m * tz + sx * hy - sy * hx
        if tree[j, 1] < 0:
            for k in range(6):
                ground_wrench[k] += f[40 + k]
    mass, friction = ground[0], ground[10]
    wx, wy, wz = mass * gravity[0], mass * gravity[1], mass * gravity[2]
    # What the ground has to give: force, and torque about its point.
    fx, fy, fz = ground_wrench[3] - wx, ground_wrench[4] - wy, ground_wrench[5] - wz
    cx, cy, cz = ground[1] - ground[7], ground[2] - ground[8], ground[3] - ground[9]
    px, py, pz = ground[7], ground[8], ground[9]
    mx = ground_wrench[0] - (cy * wz - cz * wy) - (py * ground_wrench[5] - pz * ground_wrench[4])
    my = ground_wrench[1] - (cz * wx - cx * wz) - (pz * ground_wrench[3] - px * ground_wrench[5])
    mz = ground_wrench[2] - (cx * wy - cy * wx) - (px * ground_wrench[4] - py * ground_wrench[3])
    nx, ny, nz = ground[4], ground[5], ground[6]
    pressure = fx * nx + fy * ny + fz * nz
    if pressure <= 0.0:
        return False
    # Centre of pressure, from the ground's point.
    rx = (ny * mz - nz * my) / pressure
    ry = (nz * mx - nx * mz) / pressure
    rz = (nx * my - ny * mx) / pressure
    nearest, farthest = 1e300, 0.0
    for corner in corners:
        inside = 0.0
        reach = 0.0
        for k in range(3):
            r = rx if k == 0 else ry if k == 1 else rz
            inside += corner[3 + k] * (corner[k] - r)
            reach += corner[3 + k] * corner[k]
        if inside < (1.0 - _LOAD_LIMIT) * reach:
            return False
        x, y, z = corner[0] - rx, corner[1] - ry, corner[2] - rz
        away = x * x + y * y + z * z
        nearest, farthest = min(nearest, away), max(farthest, away)
    sx, sy, sz = fx - pressure * nx, fy - pressure * ny, fz - pressure * nz
    slide = np.sqrt(sx * sx + sy * sy + sz * sz)
    twist = abs(
        (mx - (ry * sz - rz * sy)) * nx
        + (my - (rz * sx - rx * sz)) * ny
        + (mz - (rx * sy - ry * sx)) * nz
    )
    # Pressure can be shared out so that friction turns with at least the nearest corner's square
    # over the farthest's distance.
    return slide + twist * np.sqrt(farthest) / nearest <= _LOAD_LIMIT * friction * pressure


@jit("f8[:,::1], f8[:,::1], f8[::1]", allocates=False)
def _add_contact_wrenches(contacts, root, contact_wrench):
    """Torque and force (6,) of contacts, in the root's axes about its origin, added to `touch`.

    pushes (m, 15 or more): point, then three forces, each with its size and its direction, in the
    world.
    root (3, 4): world_T_root.
    """
    for push in contacts:
        fx = fy = fz = 0.0
        for k in range(3, 15, 4):
            fx += push[k] * push[k + 1]
            fy += push[k] * push[k + 2]
            fz += push[k] * push[k + 3]
        x, y, z = push[0] - root[0, 3], push[1] - root[1, 3], push[2] - root[2, 3]
        tx, ty, tz = y * fz - z * fy, z * fx - x * fz, x * fy - y * fx
        for k in range(3):
            contact_wrench[k] += root[0, k] * tx + root[1, k] * ty + root[2, k] * tz
            contact_wrench[3 + k] += root[0, k] * fx + root[1, k] * fy + root[2, k] * fz


class RestingBase:
    """A free model that stands, held as if bolted down.

    Attributes:
        mass: of its base, kg. grounds: Bullet's numbers of the bodies that it stands on.
        ground, corners, touch: numbers of the ground, its polygon and what touches, as
            `is_supported` takes them. arrays: all that it takes before dt, once the model is
            held.
    """

    def __init__(self, model: Model, ground: np.ndarray, corners: np.ndarray,
                 grounds: frozenset[int]) -> None:
        self.model = model
        self.mass = ground[0]
        self.grounds = grounds
        self.ground, self.corners = ground, corners
        self._root = model.pose().matrix()[:3]
        self.contact_wrench, self._ground_wrench = np.zeros(6), np.zeros(6)
        self._base = model.list_base_links()
        self.arrays: tuple[np.ndarray, ...] = ()

    @classmethod
    def from_contacts(cls, model: Model, models: Mapping[int, Model]) -> RestingBase | None:
        """How a free model stands; None where something that may move carries it.

        Args:
            others: all models by Bullet's number.
        """
        base = model.list_base_links()
        points, normals, friction, grounds = [], [], math.inf, set()
        for contact in pybullet.getContactPoints(bodyA=model.body_id,
                                                 physicsClientId=model.client):
            other = models[contact[2]]
            if contact[3] not in base:
                if (
                    other.fixed_base
                    and contact[8] < _CONTACT_DISTANCE
                    and _is_blocked(model, contact)
                ):
                    return None
                continue  # what it carries, or leans on: weighed when it is held
            if not other.fixed_base:
                continue
            if contact[4] != -1 or contact[8] < -_CONTACT_DISTANCE or other.release is not None:
                return None
            if contact[8] < _CONTACT_DISTANCE:
                points.append(contact[6])
                normals.append(contact[7])
                grounds.add(contact[2])
                friction = min(friction, model.body.friction[contact[3]],
                               other.body.friction[-1])
        if not points or np.ptp(normals, axis=0).max() > 1e-3:
            return None
        root = model.pose()
        if all(_is_plane(models[ground]) for ground in grounds):
            points = _find_footprint(model, np.array(points[0]), np.array(normals[0]))
        inverse = root.inverse()
        on_ground = np.array([inverse.apply(point) for point in points])
        if len(on_ground) < 3:  # of what is round there may be none
            return None
        mass, centre = _compute_base_mass(model, root)
        middle = on_ground.mean(axis=0)
        normal = np.array(rotate(inverse.quat, normals[0]))
        corners = _make_polygon(on_ground - middle, normal)
        if mass <= 0.0 or corners is None:
            return None
        middle += corners[:, :3].mean(axis=0)
        corners[:, :3] -= corners[:, :3].mean(axis=0)
        return cls(model, np.array([mass, *centre, *normal, *middle, friction]), corners,
                   frozenset(grounds))

    def fix(self) -> None:
        """Step the model as if bolted down from now on."""
        self.model.set_fixed_base(True)
        space = self.model.joints.space
        self.arrays = (space.tree, space.frames, space.state, space.previous_speeds, space.gravity,
                        self.ground, self.corners, self.contact_wrench, self._ground_wrench)

    def is_supported(self, dt: float, is_touchable: bool) -> bool:
        """Whether the ground could bear the step of `dt` s that was just made.

        touchable: whether something may touch the base though the model makes its own steps."""
        if not self.model.joints.has_own_dynamics:
            self.model.joints.read_bullet_state()
        if is_touchable or not self.model.joints.has_own_dynamics:
            self._measure_contacts()
        return is_supported(*self.arrays, dt)

    def _measure_contacts(self) -> None:
        """Note what touched the model in Bullet's step; the ground does not touch what is bolted,
        but Bullet looks at links fixed to the root all the same."""
        contacts = find_contacts(self.model.body_id, self.model.client)
        pushes = [numbers for link, other, _, numbers in contacts
                  if link not in self._base or other not in self.grounds]
        self.contact_wrench[:] = 0.0
        if pushes:
            _add_contact_wrenches(np.array(pushes), self._root, self.contact_wrench)

    def apply_excess_load(self) -> None:
        """Give the model, free again, what the ground could not bear."""
        root = self.model.pose()
        torque, force = (
            rotate(root.quat, tuple(-part)) for part in np.split(self._ground_wrench, 2)
        )
        self.model.apply_force(self.model.description.root, force, root.xyz, torque)


class RestingBases:
    """The jointed models of a world that are not bolted down, held while they stand.

    Attributes:
        fresh: whether `fix_at_start` is to be called before the next step.
        watched: whether `detect_rest` is to be called after each step of Bullet's.
        held: those that stand now; each step asks them.
    """

    def __init__(self, models: Mapping[str, Model], on_change: Callable[[], None]) -> None:
        """`on_change` tells the world that models were loaded anew."""
        self._models, self._on_change = models, on_change
        self.fixed_bases: list[RestingBase] = []
        self.is_active = self.is_new = False
        self._last_poses: dict[str, Pose] = {}
        self._countdown = CHECK_EVERY

    def refresh(self) -> None:
        """Models came, went or were loaded anew."""
        self.is_new = self.is_active = bool(self._list_free_models())
        self._last_poses = {}

    def _list_free_models(self) -> list[Model]:
        """A base that is held feels no ground, of which a contact sensor would have to tell."""
        return [
            model
            for model in self._models.values()
            if not model.fixed_base
            and model.joint_names
            and not model.body.weightless_link_masses
            and not model.description.loops
            and not model.is_attached
            and all(sensor.kind != "contact" for sensor in model.description.sensors)
        ]

    def fix_at_start(self) -> None:
        """Before the first step: hold the models that were put on the ground and stand there."""
        self.is_new = False
        free = [model for model in self._list_free_models() if model.twist() == Twist()]
        if free:
            pybullet.performCollisionDetection(physicsClientId=free[0].client)
            self._fix_resting(free)

    def detect_rest(self) -> None:
        """After a step of Bullet's: hold the free models that have come to rest."""
        self._countdown -= 1
        if self._countdown > 0:
            return
        self._countdown = CHECK_EVERY
        free = self._list_free_models()
        seen, self._last_poses = self._last_poses, {model.name: model.pose() for model in free}
        calm = [model for model in free if not model.is_disturbed and model.name in seen and
                _is_at_rest(seen[model.name], self._last_poses[model.name])]
        for model in free:
            model.is_disturbed = False
        if calm and not self._fix_resting(free):
            self._countdown = 4 * CHECK_EVERY  # Bullet finds some corners late

    def _fix_resting(self, free: list[Model]) -> bool:
        """Hold those of these models that stand; False, and nothing changed, where none does."""
        others = {model.body_id: model for model in self._models.values()}
        found = [one for one in (RestingBase.from_contacts(model, others) for model in free) if one]
        standing = [one.model for one in found]
        heaviest = max((model.mass for model in others.values()
                        if not model.fixed_base and model not in standing), default=0.0)
        found = [one for one in found if one.mass >= _LEAST_MASS_RATIO * heaviest]
        if not found:
            return False
        for base in found:
            base.fix()
            base.model.release = self.release
        self.fixed_bases = self.fixed_bases + found
        self._on_change()
        self.is_new = False
        return True

    def check_support(self, dt: float, is_touchable: bool) -> None:
        """After a step of `dt` s: set all free where the ground cannot bear one; `is_touchable` as
        Islands has it."""
        for standing in self.fixed_bases:
            if not standing.is_supported(dt, is_touchable):
                self.release_overload()
                return

    def release_overload(self) -> None:
        """Set all free: the ground could not bear one in the step that was just made."""
        held = self.fixed_bases
        self.release()
        self._countdown = RETRY_STEPS
        for standing in held:
            standing.apply_excess_load()

    def release_for(self, model: Model) -> None:
        """Set all free where one is too light to be held beside a new model."""
        if not model.fixed_base and any(
            one.mass < _LEAST_MASS_RATIO * model.mass for one in self.fixed_bases
        ):
            self.release()

    def release_from(self, model: Model) -> None:
        """A model goes, or is put elsewhere: set all free where one is held that stood on it, or
        is the model itself."""
        if any(model is one.model or model.body.body_id in one.grounds for one in self.fixed_bases):
            self.release()

    def release(self) -> None:
        """Set all free again."""
        held, self.fixed_bases = self.fixed_bases, []
        for standing in held:
            standing.model.release = None
            standing.model.set_fixed_base(False)
        if held:
            self._on_change()
            self.is_new = False


def _is_at_rest(before: Pose, now: Pose) -> bool:
    turned = sum((a - b) ** 2 for a, b in zip(before.quat, now.quat, strict=True))
    return (
        math.dist(before.xyz, now.xyz) < _REST_TOLERANCE
        and 2.0 * math.sqrt(turned) < _REST_TOLERANCE
    )


def _compute_base_mass(model: Model, root: Pose) -> tuple[float, np.ndarray]:
    """Mass (kg) and centre of mass (m, in the root's frame) of the root and what is fixed to it."""
    mass, moment = 0.0, np.zeros(3)
    base = model.list_base_links()
    for name, index in model.link_indices.items():
        inertial = model.description.links[name].inertial
        if index in base and inertial is not None:
            at = root.inverse() @ model.link_pose(name)
            mass += inertial.mass
            moment += inertial.mass * np.array(at.apply(inertial.origin_xyz))
    return mass, moment / mass if mass > 0.0 else moment


def _is_blocked(model: Model, contact: tuple) -> bool:
    """Whether no joint can move a contact's point along its normal, as no axle moves the point
    where its wheel stands. Were the root bolted down, no force would be too large to end there."""
    point, normal = np.array(contact[5]), np.array(contact[7])
    names = {index: name for name, index in model.link_indices.items()}
    movers = {joint.child: joint for joint in model.description.joints.values()}
    link, most = names[contact[3]], 0.0
    while link in movers:
        joint = movers[link]
        if joint.is_movable:
            frame = model.link_pose(link)
            along = np.array(rotate(frame.quat, joint.axis))
            if joint.kind != "prismatic":
                lever = point - frame.xyz
                along = np.cross(along, lever) / max(np.linalg.norm(lever), _CONTACT_DISTANCE)
            most = max(most, abs(along @ normal))
        link = joint.parent
    return most < _SMALLEST_LEVER


def _is_plane(model: Model) -> bool:
    collisions = model.description.links[model.description.root].collisions
    return all(collision.geometry.kind == "plane" for collision in collisions)


def _find_footprint(model: Model, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Where the base touches a plane, (m, 3), in the world: contacts tell of few corners only."""
    found = []
    base = model.list_base_links()
    for name, index in model.link_indices.items():
        near = _CONTACT_DISTANCE + (0.0 if index == -1 else LINK_MARGIN)
        for part in model.description.links[name].collisions if index in base else ():
            at = model.link_pose(name) @ part.pose
            matrix = at.matrix()
            for own in _list_corners(part.geometry):
                corners = own @ matrix[:3, :3].T + matrix[:3, 3]
                above = (corners - point) @ normal
                down = np.abs(above) < near
                found.append(corners[down] - above[down, None] * normal)
    return np.concatenate(found)


def _list_corners(geometry: Geometry) -> Iterator[np.ndarray]:
    """Points (m, 3) of which a shape is the hull, m."""
    if geometry.kind == "box":  # most are, and triangles take a millisecond
        signs = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
        yield np.array(signs) * geometry.size
    else:
        for mesh in shapes.make_meshes(geometry):
            yield mesh.positions.astype(float)


def _make_polygon(points: np.ndarray, normal: np.ndarray) -> np.ndarray | None:
    """Corners and outward edge normals (m, 6) of the hull of points on a plane; None for a line."""
    aside = np.cross(normal, (1.0, 0.0, 0.0) if abs(normal[0]) < 0.7 else (0.0, 1.0, 0.0))
    aside /= np.linalg.norm(aside)
    axes = np.stack([aside, np.cross(normal, aside)])
    flat = points @ axes.T
    hull = cv2.convexHull(flat.astype(np.float32), clockwise=False, returnPoints=False).ravel()
    if len(hull) < 3:
        return None
    corners = flat[hull]
    along = np.roll(corners, -1, axis=0) - corners
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    return np.hstack([corners @ axes, outward @ axes])
