"""libgazebo_grasp_fix.so: what fingers press from opposite sides is attached to the palm.

Friction alone does not hold things for long in a simulated gripper. The plug-in counts, some times
a second, whether two fingers push an object with opposed forces; beyond a threshold the object is
attached to the palm, and it is let go once the count has fallen and a finger has moved away from
the place where it touched (JenniferBuehler/gazebo-pkgs, GazeboGraspFix).
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from aras_sim_bridge.description.types import GraspArm, GraspDescription
from aras_sim_bridge.world.attachments import Attachments, Ends
from aras_sim_bridge.world.bullet import contacts_of, pybullet
from aras_sim_bridge.world.model import Model
from aras_sim_bridge.world.world import World
from aras_visual_servo_base.poses import Pose

log = logging.getLogger(__name__)

_LEAST_FORCE = 1e-4  # N; upstream passes over smaller ones
_LEAST_RATIO = 0.3  # of the smaller of two opposed forces to the greater, as upstream
_NEVER = 1 << 62  # ns
Thing = tuple[str, str]  # model and link


@dataclass
class Pressed:
    """Sums over the steps in which a finger pressed a thing.

    force: on the thing, in the world, N. point, origin: of the contact and of the thing, in the
    finger's frame, m.
    """

    steps: int = 0
    force: np.ndarray = field(default_factory=lambda: np.zeros(3))
    point: np.ndarray = field(default_factory=lambda: np.zeros(3))
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def add(self, force: np.ndarray, point: np.ndarray, origin: np.ndarray) -> None:
        """One step more."""
        self.steps += 1
        self.force += force
        self.point += point
        self.origin += origin


@dataclass
class Grasped:
    """What an arm holds, by which joint, and where its fingers touched when it was attached."""

    thing: Thing
    ends: Ends
    touched: dict[str, Pressed]


def opposed(forces: Iterable[np.ndarray], angle: float) -> bool:
    """Whether two of these forces are at more than `angle` (rad) and of comparable size."""
    for one, other in combinations(forces, 2):
        sizes = sorted((float(np.linalg.norm(one)), float(np.linalg.norm(other))))
        if sizes[0] < _LEAST_FORCE or sizes[0] < _LEAST_RATIO * sizes[1]:
            continue
        cosine = float(one @ other) / (sizes[0] * sizes[1])
        if math.acos(max(-1.0, min(1.0, cosine))) > angle:
            return True
    return False


class GraspFix:
    """The plug-in of one model, in simulated time (upstream's counts by the wall clock).

    Attributes:
        model: whose grippers grasp. held: what an arm holds, by the arm's name.
    """

    def __init__(self, description: GraspDescription, model: Model, world: World) -> None:
        self.description, self.model = description, model
        self._world = world
        self._arm_of = {finger: arm for arm in description.arms for finger in arm.fingers}
        self.held: dict[str, Grasped] = {}
        self._begin()

    def _begin(self) -> None:
        self.held.clear()
        self._counts: dict[Thing, int] = {}
        self._pressed: dict[Thing, dict[str, Pressed]] = {}
        self._due_ns = 0

    @property
    def _attachments(self) -> Attachments:
        return self._world.attachments

    @property
    def idle_until_ns(self) -> int:
        """Up to when, ns, steps may end without `after_step`: nothing touches what makes its own
        steps."""
        if self.model.joints.own and not self._counts and not self._pressed:
            return _NEVER
        return self._due_ns - 1

    def reset(self) -> None:
        """Begin anew: the clock jumped, and nothing is attached any more."""
        self._begin()

    def after_step(self, time_ns: int) -> None:
        """Note what the fingers press in the step that ended at `time_ns`, and count."""
        if not self.model.joints.own:
            self._feel()
        if time_ns >= self._due_ns:
            self._due_ns = time_ns + round(1e9 / self.description.rate)
            self._count()

    def _feel(self) -> None:
        model = self.model
        fingers = {model.link_index(name): name for name in self._arm_of}
        if not any(pybullet.getContactPoints(bodyA=model.body_id, linkIndexA=index,
                                             physicsClientId=model.client) for index in fingers):
            return
        others = {one.body_id: one for one in self._world.models.values()}
        names = {}
        found: dict[tuple[str, Thing], list[tuple[float, ...]]] = {}
        for link, body, other_link, numbers in contacts_of(model.body_id, model.client):
            other = others[body]
            if link not in fingers or numbers[3] == 0.0 or other.description.static:
                continue
            if body not in names:
                names[body] = {index: name for name, index in other.link_indices.items()}
            thing = other.whole.name, names[body][other_link]
            found.setdefault((fingers[link], thing), []).append(numbers)
        for (finger, thing), points in found.items():
            values = np.array(points)
            on_finger = sum(values[:, [k]] * values[:, k + 1:k + 4] for k in (3, 7, 11))
            back = model.link_pose(finger).inverse()
            origin = self._pose(thing).xyz
            pressed = self._pressed.setdefault(thing, {}).setdefault(finger, Pressed())
            pressed.add(-on_finger.mean(axis=0), np.array(back.apply(values[:, :3].mean(axis=0))),
                        np.array(back.apply(origin)))

    def _count(self) -> None:
        pressed = {thing: fingers for thing, fingers in self._pressed.items()
                   if self._exists(thing)}
        self._pressed = {}
        for name, grasped in list(self.held.items()):
            if grasped.ends not in self._attachments:  # its model is gone
                del self.held[name]
        gripped = [thing for thing, fingers in pressed.items()
                   if opposed((one.force / one.steps for one in fingers.values()),
                              self.description.angle)]
        for thing in gripped:
            count = min(self._counts.get(thing, 0) + 1, self.description.most)
            self._counts[thing] = count
            if count > self.description.threshold:
                self._hold(thing, pressed[thing])
        for thing in [one for one in self._counts if one not in gripped]:
            self._counts[thing] -= 1
            if self._counts[thing] <= self.description.threshold:
                self._release(thing)
            if self._counts[thing] <= 0 and thing not in self._things():
                del self._counts[thing]

    def _exists(self, thing: Thing) -> bool:
        return self._body(thing) is not None

    def _body(self, thing: Thing) -> Model | None:
        model = self._world.models.get(thing[0])
        bodies = model.bodies if model is not None else ()
        return next((one for one in bodies if thing[1] in one.link_indices), None)

    def _pose(self, thing: Thing) -> Pose:
        return self._body(thing).link_pose(thing[1])

    def _things(self) -> dict[Thing, str]:
        return {grasped.thing: name for name, grasped in self.held.items()}

    def _hold(self, thing: Thing, fingers: dict[str, Pressed]) -> None:
        """Attach a thing to the arm most of whose fingers press it."""
        if thing in self._things():
            return
        arms = [self._arm_of[finger] for finger in fingers]
        arm: GraspArm = max(arms, key=arms.count)
        if arm.name in self.held:
            return
        ends = Ends(self.model.name, arm.palm, *thing)
        touched = {finger: one for finger, one in fingers.items() if finger in arm.fingers}
        self._attachments.attach(ends, collides=self.description.collides)
        self.held[arm.name] = Grasped(thing, ends, touched)
        log.info("model '%s': arm '%s' holds '%s::%s'", self.model.name, arm.name, *thing)

    def _release(self, thing: Thing) -> None:
        """Let a thing go where a finger has moved away from the place where it touched."""
        name = self._things().get(thing)
        if name is None:
            return
        origin = np.array(self._pose(thing).xyz)
        for finger, one in self.held[name].touched.items():
            point = one.point / one.steps
            before = np.linalg.norm(point - one.origin / one.steps)
            now = np.linalg.norm(self.model.link_pose(finger).apply(point) - origin)
            if abs(now - before) > self.description.release_tolerance:
                self._attachments.detach(self.held.pop(name).ends)
                self._counts[thing] = 0
                log.info("model '%s': arm '%s' lets '%s::%s' go", self.model.name, name, *thing)
                return
