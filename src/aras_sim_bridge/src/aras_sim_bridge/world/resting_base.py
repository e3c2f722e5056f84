"""Free bases at rest, which are simulated as fixed bases while the ground can support them.

The robot of the original project weighs 1.7 t and rests on the floor with twelve corners. Computing
their contacts takes five times as long as computing the motion of the arm, only to find that the
base does not move. Therefore a free model that rests on a static body is stepped as if its base
were fixed, similar to a sleeping body in ODE.

After every step, ground_support.py computes whether the ground can support the base. If not, or if
the model is pushed, moved or changed, the base becomes free again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from aras_sim_bridge.description import Geometry, shape_meshes
from aras_sim_bridge.world.bullet import find_contacts, pybullet
from aras_sim_bridge.world.bullet_body import LINK_MARGIN
from aras_sim_bridge.world.ground_support import (
    add_contact_wrenches,
    is_supported,
    make_support_polygon,
)
from aras_sim_bridge.world.model import Model
from aras_visual_servo_base.poses import Pose, Twist, rotate

CHECK_EVERY = 50  # number of steps between two checks whether free bases are at rest
# After the ground could not support a base, free bases are checked for rest again after this number
# of steps.
RETRY_STEPS = 1000
# A base is at rest if it moves by less than this between two checks, m and rad.
_REST_TOLERANCE = 1e-6
# Distance below which two bodies are in contact, m. In Bullet, a body at rest sinks into the ground
# by a tenth of this distance.
_CONTACT_DISTANCE = 1e-4
# A joint counts as able to move a contact point along the contact normal if the velocity of the
# point along the normal is at least this fraction of v. For a prismatic joint, v is the joint's
# speed; for a revolute joint, it is this speed times the distance between the point and the joint's
# origin.
_SMALLEST_LEVER = 0.05
# A resting base is treated as fixed only if its mass is at least this multiple of the mass of every
# free body. A free body that hits the base rebounds as from a wall in this step. The relative error
# of its speed is then at most the inverse of this ratio.
_LEAST_MASS_RATIO = 100.0


class RestingBase:
    """A free model at rest, which is stepped as if its base were fixed.

    Attributes:
        model: the model.
        mass: mass of the model's base, kg.
        grounds: Bullet's ids of the bodies that the base rests on.
        ground, corners, contact_wrench: arguments of `is_supported`.
        arrays: all arguments of `is_supported` except dt; empty until the base is fixed.
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
        """Return the RestingBase of a free model, or None if it does not rest on static bodies.

        Args:
            model: free model.
            models: all models by Bullet's body id.
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
                # only contacts of the base support the base; the others are part of
                # `contact_wrench`
                continue
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
        if len(on_ground) < 3:  # only a round shape has fewer than three points on the ground
            return None
        mass, centre = _compute_base_mass(model, root)
        middle = on_ground.mean(axis=0)
        normal = np.array(rotate(inverse.quat, normals[0]))
        corners = make_support_polygon(on_ground - middle, normal)
        if mass <= 0.0 or corners is None:
            return None
        middle += corners[:, :3].mean(axis=0)
        corners[:, :3] -= corners[:, :3].mean(axis=0)
        return cls(model, np.array([mass, *centre, *normal, *middle, friction]), corners,
                   frozenset(grounds))

    def fix(self) -> None:
        """Treat the base as fixed from the next step on."""
        self.model.set_fixed_base(True)
        space = self.model.joints.space
        self.arrays = (space.tree, space.frames, space.state, space.previous_speeds, space.gravity,
                        self.ground, self.corners, self.contact_wrench, self._ground_wrench)

    def is_supported(self, dt: float, is_touchable: bool) -> bool:
        """Return whether the ground supported the base in the last step of `dt` s.

        `is_touchable` states whether another body may touch the base. If it is False, Bullet's
        contacts are only read if Bullet made the step.
        """
        if not self.model.joints.has_own_dynamics:
            self.model.joints.read_bullet_state()
        if is_touchable or not self.model.joints.has_own_dynamics:
            self._measure_contacts()
        return is_supported(*self.arrays, dt)

    def _measure_contacts(self) -> None:
        """Compute the wrench on the model by all contacts in Bullet's last step.

        Contacts of the base with the ground do not count, because the force of the ground is
        computed by `is_supported`.
        """
        contacts = find_contacts(self.model.body_id, self.model.client)
        pushes = [numbers for link, other, _, numbers in contacts
                  if link not in self._base or other not in self.grounds]
        self.contact_wrench[:] = 0.0
        if pushes:
            add_contact_wrenches(np.array(pushes), self._root, self.contact_wrench)

    def apply_excess_load(self) -> None:
        """Apply the load of the last step to the base after it was freed.

        In that step the base was still fixed, although the ground could not support this load.
        """
        root = self.model.pose()
        torque, force = (
            rotate(root.quat, tuple(-part)) for part in np.split(self._ground_wrench, 2)
        )
        self.model.apply_force(self.model.description.root, force, root.xyz, torque)


class RestingBases:
    """All bases of a world that are at rest and therefore treated as fixed.

    Attributes:
        is_new: whether `fix_at_start` must be called before the next step.
        is_active: whether `detect_rest` must be called after each step of Bullet.
        fixed_bases: bases that are treated as fixed. If there are any, `check_support` must be
            called after each step.
    """

    def __init__(self, models: Mapping[str, Model], on_change: Callable[[], None]) -> None:
        """Create an object without fixed bases.

        `on_change` is called after bases were fixed or freed.
        """
        self._models, self._on_change = models, on_change
        self.fixed_bases: list[RestingBase] = []
        self.is_active = self.is_new = False
        self._last_poses: dict[str, Pose] = {}
        self._countdown = CHECK_EVERY

    def refresh(self) -> None:
        """Look again for models whose base may come to rest.

        This is called after models were spawned, deleted or reloaded.
        """
        self.is_new = self.is_active = bool(self._list_free_models())
        self._last_poses = {}

    def _list_free_models(self) -> list[Model]:
        """Return the free models with joints whose base may be treated as fixed.

        Models with a contact sensor are excluded: a fixed base has no contact with the ground.
        """
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
        """Fix the bases of models that start at rest on the ground, before the first step."""
        self.is_new = False
        free = [model for model in self._list_free_models() if model.twist() == Twist()]
        if free:
            pybullet.performCollisionDetection(physicsClientId=free[0].client)
            self._fix_resting(free)

    def detect_rest(self) -> None:
        """Fix the bases of free models that have come to rest; called after each Bullet step."""
        self._countdown -= 1
        if self._countdown > 0:
            return
        self._countdown = CHECK_EVERY
        free = self._list_free_models()
        last_poses, self._last_poses = (
            self._last_poses,
            {model.name: model.pose() for model in free},
        )
        resting = [
            model
            for model in free
            if not model.is_disturbed
            and model.name in last_poses
            and _is_at_rest(last_poses[model.name], self._last_poses[model.name])
        ]
        for model in free:
            model.is_disturbed = False
        if resting and not self._fix_resting(free):
            # Check again after a few more steps, because Bullet may then have found more of the
            # contacts on which the base rests.
            self._countdown = 4 * CHECK_EVERY

    def _fix_resting(self, free: list[Model]) -> bool:
        """Find the models in `free` that rest on static bodies, and treat their bases as fixed.

        Return False if there is no such model.
        """
        others = {model.body_id: model for model in self._models.values()}
        found = [one for one in (RestingBase.from_contacts(model, others) for model in free) if one]
        resting = [one.model for one in found]
        heaviest = max((model.mass for model in others.values()
                        if not model.fixed_base and model not in resting), default=0.0)
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
        """Free all bases if the ground could not support one of them in the last step of `dt` s.

        `is_touchable` states whether a free body may touch a base.
        """
        for base in self.fixed_bases:
            if not base.is_supported(dt, is_touchable):
                self.release_overload()
                return

    def release_overload(self) -> None:
        """Free all bases because the ground could not support one of them.

        The loads of the last step are applied to the bases.
        """
        bases = self.fixed_bases
        self.release()
        self._countdown = RETRY_STEPS
        for base in bases:
            base.apply_excess_load()

    def release_for(self, model: Model) -> None:
        """Free all bases if the new free model `model` is too heavy for one of them.

        A base is only treated as fixed if it is much heavier than every free body.
        """
        if not model.fixed_base and any(
            one.mass < _LEAST_MASS_RATIO * model.mass for one in self.fixed_bases
        ):
            self.release()

    def release_from(self, model: Model) -> None:
        """Free all bases if one of them belongs to `model` or rests on it.

        This must be called before `model` is moved or deleted.
        """
        if any(model is one.model or model.body.body_id in one.grounds for one in self.fixed_bases):
            self.release()

    def release(self) -> None:
        """Free all bases."""
        bases, self.fixed_bases = self.fixed_bases, []
        for base in bases:
            base.model.release = None
            base.model.set_fixed_base(False)
        if bases:
            self._on_change()
            self.is_new = False


def _is_at_rest(before: Pose, now: Pose) -> bool:
    turned = sum((a - b) ** 2 for a, b in zip(before.quat, now.quat, strict=True))
    return (
        math.dist(before.xyz, now.xyz) < _REST_TOLERANCE
        and 2.0 * math.sqrt(turned) < _REST_TOLERANCE
    )


def _compute_base_mass(model: Model, root: Pose) -> tuple[float, np.ndarray]:
    """Return the mass (kg) and the centre of mass (m, root frame) of the base.

    The base consists of the root and the links that are fixed to it.
    """
    mass, moment = 0.0, np.zeros(3)
    base = model.list_base_links()
    for name, index in model.link_indices.items():
        inertial = model.description.links[name].inertial
        if index in base and inertial is not None:
            pose = root.inverse() @ model.link_pose(name)
            mass += inertial.mass
            moment += inertial.mass * np.array(pose.apply(inertial.origin_xyz))
    return mass, moment / mass if mass > 0.0 else moment


def _is_blocked(model: Model, contact: tuple) -> bool:
    """Return whether no joint can move the contact point along the contact normal.

    An example is the point below the axle of a wheel, which no rotation of the wheel moves up or
    down. If the root were fixed, the contact force at such a point could grow without bound.
    """
    point, normal = np.array(contact[5]), np.array(contact[7])
    names = {index: name for name, index in model.link_indices.items()}
    movers = {joint.child: joint for joint in model.description.joints.values()}
    link, largest = names[contact[3]], 0.0
    while link in movers:
        joint = movers[link]
        if joint.is_movable:
            frame = model.link_pose(link)
            along = np.array(rotate(frame.quat, joint.axis))
            if joint.kind != "prismatic":
                lever = point - frame.xyz
                along = np.cross(along, lever) / max(np.linalg.norm(lever), _CONTACT_DISTANCE)
            largest = max(largest, abs(along @ normal))
        link = joint.parent
    return largest < _SMALLEST_LEVER


def _is_plane(model: Model) -> bool:
    collisions = model.description.links[model.description.root].collisions
    return all(collision.geometry.kind == "plane" for collision in collisions)


def _find_footprint(model: Model, point: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Return the points (m, 3) in the world where the base touches a plane.

    They are computed from the collision shapes, because Bullet's contacts do not contain all
    corners.
    """
    found = []
    base = model.list_base_links()
    for name, index in model.link_indices.items():
        near = _CONTACT_DISTANCE + (0.0 if index == -1 else LINK_MARGIN)
        for part in model.description.links[name].collisions if index in base else ():
            at = model.link_pose(name) @ part.pose
            matrix = at.matrix()
            for vertices in _list_corners(part.geometry):
                corners = vertices @ matrix[:3, :3].T + matrix[:3, 3]
                above = (corners - point) @ normal
                is_near = np.abs(above) < near
                found.append(corners[is_near] - above[is_near, None] * normal)
    return np.concatenate(found)


def _list_corners(geometry: Geometry) -> Iterator[np.ndarray]:
    """Yield the corners (m, 3) of a shape's convex parts."""
    # Boxes are frequent, and their triangulation would take a millisecond.
    if geometry.kind == "box":
        signs = [(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
        yield np.array(signs) * geometry.size
    else:
        for mesh in shape_meshes.make_meshes(geometry):
            yield mesh.positions.astype(float)
