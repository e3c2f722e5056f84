"""Counterpart of libgazebo_grasp_fix.so: a grasped object is attached to the palm of the gripper.

Friction alone does not hold an object for long in a simulated gripper. Several times a second, the
plug-in checks for each object whether two fingers press it with opposed forces. It increases a
counter of the object if they do, and decreases it otherwise. If the counter exceeds a threshold,
the object is attached to the palm. The object is released when its counter has fallen to the
threshold and a finger has moved away from its contact point. This is the algorithm of
GazeboGraspFix (JenniferBuehler/gazebo-pkgs).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from aras_sim_bridge.description.types import GraspFixPlugin, GripperDescription
from aras_sim_bridge.world.attachments import LinkPair
from aras_sim_bridge.world.bullet import find_contacts, pybullet
from aras_sim_bridge.world.model import Model
from aras_sim_bridge.world.world import World
from aras_visual_servo_base.poses import Pose

log = logging.getLogger(__name__)

# Smallest force of a finger that counts for a grasp, N; as in gazebo_grasp_fix.
_LEAST_FORCE = 1e-4
# Smallest ratio of the smaller to the larger of two opposed finger forces; as in gazebo_grasp_fix.
_LEAST_RATIO = 0.3
_NEVER = 1 << 62  # time that is never reached, ns
LinkId = tuple[str, str]  # names of a model and of its link


@dataclass
class FingerContact:
    """Contact of a finger with an object, summed over all steps in which the finger pressed it.

    Divide the sums by `steps` to get averages.

    Attributes:
        steps: number of these steps.
        force: sum of the forces on the object in world axes, N.
        point: sum of the contact points in the finger's frame, m.
        origin: sum of the positions of the object's origin in the finger's frame, m.
    """

    steps: int = 0
    force: np.ndarray = field(default_factory=lambda: np.zeros(3))
    point: np.ndarray = field(default_factory=lambda: np.zeros(3))
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def add(self, force: np.ndarray, point: np.ndarray, origin: np.ndarray) -> None:
        """Add the force, the contact point and the origin of one step."""
        self.steps += 1
        self.force += force
        self.point += point
        self.origin += origin


@dataclass
class GraspedLink:
    """An object that an arm holds.

    Attributes:
        link: model and link of the object.
        ends: links that the fixed joint connects: the palm and the object.
        finger_contacts: contacts of the arm's fingers when the object was attached, by finger.
    """

    link: LinkId
    ends: LinkPair
    finger_contacts: dict[str, FingerContact]


def has_opposed_forces(forces: Iterable[np.ndarray], angle: float) -> bool:
    """Return whether two of the forces have similar magnitudes and opposed directions.

    Directions are opposed if they differ by more than `angle` (rad).
    """
    for one, other in combinations(forces, 2):
        sizes = sorted((float(np.linalg.norm(one)), float(np.linalg.norm(other))))
        if sizes[0] < _LEAST_FORCE or sizes[0] < _LEAST_RATIO * sizes[1]:
            continue
        cosine = float(one @ other) / (sizes[0] * sizes[1])
        if math.acos(max(-1.0, min(1.0, cosine))) > angle:
            return True
    return False


class GraspFix:
    """Grasp plug-in of one model. It uses simulated time; upstream's plug-in uses the wall clock.

    Attributes:
        model: model with the grippers.
        grasped: the object that each arm holds, by the arm's name.
    """

    def __init__(self, description: GraspFixPlugin, model: Model, world: World) -> None:
        self.description, self.model = description, model
        self._world = world
        self._arm_of = {finger: arm for arm in description.arms for finger in arm.fingers}
        self.grasped: dict[str, GraspedLink] = {}
        self.reset()

    def reset(self) -> None:
        """Reset the counters of all objects.

        This is called after the clock jumped and all objects were detached.
        """
        self.grasped.clear()
        self._counts: dict[LinkId, int] = {}
        self._finger_contacts: dict[LinkId, dict[str, FingerContact]] = {}
        self._due_ns = 0

    @property
    def idle_until_ns(self) -> int:
        """Simulated time, ns, until which `after_step` need not be called.

        A model that Bullet does not step touches nothing, so its fingers need no checks.
        """
        if self.model.joints.has_own_dynamics and not self._counts and not self._finger_contacts:
            return _NEVER
        return self._due_ns - 1

    def after_step(self, time_ns: int) -> None:
        """Record the finger contacts of the step that ended at `time_ns` (simulated time, ns).

        If a check is due, update the counter of each object, and attach or release the object.
        """
        if not self.model.joints.has_own_dynamics:
            self._collect_contacts()
        if time_ns >= self._due_ns:
            self._due_ns = time_ns + round(1e9 / self.description.rate)
            self._update_counts()

    def _collect_contacts(self) -> None:
        model = self.model
        fingers = {model.link_index(name): name for name in self._arm_of}
        if not any(pybullet.getContactPoints(bodyA=model.body_id, linkIndexA=index,
                                             physicsClientId=model.client) for index in fingers):
            return
        others = {one.body_id: one for one in self._world.models.values()}
        names = {}
        found: dict[tuple[str, LinkId], list[tuple[float, ...]]] = {}
        for link, body, other_link, numbers in find_contacts(model.body_id, model.client):
            other = others[body]
            if link not in fingers or numbers[3] == 0.0 or other.description.static:
                continue
            if body not in names:
                names[body] = {index: name for name, index in other.link_indices.items()}
            thing = other.main_model.name, names[body][other_link]
            found.setdefault((fingers[link], thing), []).append(numbers)
        for (finger, thing), points in found.items():
            values = np.array(points)
            on_finger = sum(values[:, [k]] * values[:, k + 1:k + 4] for k in (3, 7, 11))
            back = model.link_pose(finger).inverse()
            origin = self._read_pose(thing).xyz
            pressed = self._finger_contacts.setdefault(thing, {}).setdefault(
                finger, FingerContact()
            )
            pressed.add(-on_finger.mean(axis=0), np.array(back.apply(values[:, :3].mean(axis=0))),
                        np.array(back.apply(origin)))

    def _update_counts(self) -> None:
        pressed = {thing: fingers for thing, fingers in self._finger_contacts.items()
                   if self._find_body(thing) is not None}
        self._finger_contacts = {}
        for name, grasped in list(self.grasped.items()):
            # the model of the grasped object has been deleted
            if grasped.ends not in self._world.attachments:
                del self.grasped[name]
        gripped = [thing for thing, fingers in pressed.items()
                   if has_opposed_forces((one.force / one.steps for one in fingers.values()),
                              self.description.angle)]
        for thing in gripped:
            count = min(self._counts.get(thing, 0) + 1, self.description.most)
            self._counts[thing] = count
            if count > self.description.threshold:
                self._attach(thing, pressed[thing])
        for thing in [one for one in self._counts if one not in gripped]:
            self._counts[thing] -= 1
            if self._counts[thing] <= self.description.threshold:
                self._release(thing)
            if self._counts[thing] <= 0 and thing not in self._arms_by_link():
                del self._counts[thing]

    def _find_body(self, link: LinkId) -> Model | None:
        model = self._world.models.get(link[0])
        return None if model is None else model.find_body(link[1])

    def _read_pose(self, link: LinkId) -> Pose:
        return self._find_body(link).link_pose(link[1])

    def _arms_by_link(self) -> dict[LinkId, str]:
        return {grasped.link: name for name, grasped in self.grasped.items()}

    def _attach(self, link: LinkId, fingers: dict[str, FingerContact]) -> None:
        """Attach an object to the arm that presses it with the most fingers."""
        if link in self._arms_by_link():
            return
        arms = [self._arm_of[finger] for finger in fingers]
        arm: GripperDescription = max(arms, key=arms.count)
        if arm.name in self.grasped:
            return
        ends = LinkPair(self.model.name, arm.palm, *link)
        touched = {finger: one for finger, one in fingers.items() if finger in arm.fingers}
        self._world.attachments.attach(ends, collides=self.description.collides)
        self.grasped[arm.name] = GraspedLink(link, ends, touched)
        log.info("model '%s': arm '%s' holds '%s::%s'", self.model.name, arm.name, *link)

    def _release(self, link: LinkId) -> None:
        """Release an object if a finger has moved away from its contact point."""
        name = self._arms_by_link().get(link)
        if name is None:
            return
        origin = np.array(self._read_pose(link).xyz)
        for finger, one in self.grasped[name].finger_contacts.items():
            point = one.point / one.steps
            before = np.linalg.norm(point - one.origin / one.steps)
            now = np.linalg.norm(self.model.link_pose(finger).apply(point) - origin)
            if abs(now - before) > self.description.release_tolerance:
                self._world.attachments.detach(self.grasped.pop(name).ends)
                self._counts[link] = 0
                log.info("model '%s': arm '%s' releases '%s::%s'", self.model.name, name, *link)
                return
