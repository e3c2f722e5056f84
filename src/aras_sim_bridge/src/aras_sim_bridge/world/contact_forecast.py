"""Choice of the solver for each model with a fixed base: joint_dynamics.py or Bullet.

A step of joint_dynamics.py takes a tenth of the time of a step of Bullet and is exact. Its result
does not depend on other models, not even in the last bit. However, it computes no contacts.
Therefore Bullet steps a model while another body may touch it. This is decided from the distances
between bounding boxes. The next check is due when the fastest bodies could have covered the
distance. Until then, no body can touch the model, so the model need not move in Bullet.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from aras_sim_bridge.world.collision_filters import (
    MARGIN,
    BoundingBox,
    HalfSpace,
    can_meet,
    compute_reach,
    find_solids,
)
from aras_sim_bridge.world.model import Model

# Distance between the bounding boxes of two bodies below which they may touch in the next step, m.
_CONTACT_DISTANCE = 0.02
# Assumed largest increase of a body's speed between two checks, m/s. It is added to all measured
# speeds.
_SPEED_MARGIN = 5.0
# Bullet stops stepping a model, and joint_dynamics.py steps it again, only if no contact is
# possible within this number of steps.
_RETURN_STEPS = 8
_FAR = 1e9  # assumed gap between two models if one of them has no shapes, m
# Assumed distance of a robot's links from its joint axes, m. Joint speeds times this length bound
# the speeds of the links of a nearby robot.
_ARM_LENGTH = 2.0
# Numbers of steps until the next check of a model: _OFTEN while Bullet steps the model; _WITHIN or
# fewer if another body may come within the model's reach; _SELDOM if all bodies are far from this
# reach; _NEVER if there are neither free bodies nor models nearby.
_OFTEN, _WITHIN, _SELDOM, _NEVER = 10, 20, 100, 1 << 60


@dataclass(eq=False)
class IsolatedModel:
    """Fixed-base model that joint_dynamics.py may step.

    Attributes:
        model: the model.
        reach: boxes that the moving links never leave.
        links: Bullet's indices of the moving links.
        nearby_models: other fixed-base models that the moving links may touch.
    """

    model: Model
    reach: tuple[BoundingBox, ...]
    links: frozenset[int]
    nearby_models: tuple[Model, ...]

    def compute_boxes_and_speed(self) -> tuple[list[BoundingBox], float]:
        """Return the boxes of the moving links, and an upper bound of their speed, m/s."""
        boxes = find_solids(self.model, self.links)
        root = self.model.pose().xyz
        corners = [(*low, *high) for low, high in (*boxes, BoundingBox(root, root))]
        extent = math.dist(*(tuple(map(pick, zip(*corners, strict=True)))[part]
                             for pick, part in ((min, slice(0, 3)), (max, slice(3, 6)))))
        return boxes, sum(map(abs, self.model.read_joints()[1])) * max(1.0, extent)

    def compute_isolated_steps(
        self, loose: list[list[BoundingBox | HalfSpace]], fastest: float, dt: float
    ) -> float:
        """Return the number of steps of `dt` s in which no body can touch the moving links.

        Args:
            loose: boxes and half-spaces of each free model.
            fastest: highest speed among the free models, m/s.
            dt: time step, s.
        """
        if not (loose or self.nearby_models):
            return _NEVER
        far = min(
            (_compute_steps(self.reach, solid, fastest, dt) for solid in loose), default=_SELDOM
        )
        # No free body is near the space that the robot can reach.
        if far >= _SELDOM and not self.nearby_models:
            return _SELDOM
        boxes, speed = self.compute_boxes_and_speed()
        near = [_compute_steps(boxes, solid, speed + fastest, dt) for solid in loose]
        for other in self.nearby_models:
            joint_speed = speed + sum(map(abs, other.read_joints()[1])) * _ARM_LENGTH
            near.append(
                _compute_steps(
                    boxes, find_solids(other, other.link_indices.values()), joint_speed, dt
                )
            )
        return min(_WITHIN, *near)


class ContactForecast:
    """Monitors which bodies may touch the fixed-base models of a world.

    Attributes:
        isolated_models: fixed-base models with joints, which joint_dynamics.py may step.
        steps_until_update: steps until `update` is due.
        is_base_touchable: whether a free body may touch a resting base that is treated as fixed.
    """

    def __init__(self, models: Mapping[str, Model], window: bool) -> None:
        """Create a monitor. If `window` is True, Bullet steps all models, to show them there."""
        self._models, self._window = models, window
        self.isolated_models: list[IsolatedModel] = []
        self._loose: list[Model] = []
        self.steps_until_update, self.is_base_touchable = 0, False

    def refresh(self) -> None:
        """Find the models to monitor; called after models were spawned, deleted, fixed or freed."""
        models = self._models.values()
        fixed = [model for model in models if model.fixed_base]
        self._loose = [model for model in models if not model.fixed_base]
        self.isolated_models = []
        for model in () if self._window else fixed:
            if model.joint_names and not model.description.loops:
                reach = compute_reach(model)
                moved = {link: reach[link].grow(MARGIN) for link in model.joints.moving_links
                         if link in reach}
                self.isolated_models.append(IsolatedModel(
                    model, tuple(moved.values()), frozenset(map(model.link_index, moved)),
                    tuple(other for other in fixed
                          if other is not model and can_meet(moved.values(), other))))
        self.steps_until_update = 0

    def replace_model(self, model: Model) -> None:
        """Update which models can touch the fixed-base model `model`, after it was moved."""
        if model.joint_names:
            self.refresh()
            return
        for isolated in self.isolated_models:
            if isolated.model is not model:
                others = tuple(one for one in isolated.nearby_models if one is not model)
                isolated.nearby_models = (
                    (*others, model) if can_meet(isolated.reach, model) else others
                )
        self.steps_until_update = 0

    def update(self, dt: float) -> None:
        """Choose, for each model, the solver of the following steps of `dt` s."""
        loose = [find_solids(model, model.link_indices.values()) for model in self._loose]
        # Highest speed of the free bodies, m/s. It is doubled, because a body that another one hits
        # may become faster.
        fastest = 2.0 * max(map(_compute_speed, self._loose), default=0.0)
        wait, self.is_base_touchable = _NEVER, False
        for isolated in self.isolated_models:
            model = isolated.model
            steps = (
                0.0 if model.is_attached else isolated.compute_isolated_steps(loose, fastest, dt)
            )
            is_isolated = steps >= (1 if model.joints.has_own_dynamics else _RETURN_STEPS)
            # Wake a sleeping body one step early, because in Bullet it moves only from the second
            # step on.
            if model.body.is_asleep and not is_isolated:
                model.body.set_asleep(False)
                wait = 1
                continue
            if is_isolated and not model.body.is_asleep:
                model.body.set_asleep(True)
            model.joints.set_own_dynamics(is_isolated)
            wait = min(wait, steps if is_isolated else _OFTEN)
            if model.release is not None and loose:
                base = find_solids(model, model.list_base_links())
                steps = min(_compute_steps(solid, base, fastest, dt) for solid in loose)
                self.is_base_touchable = self.is_base_touchable or steps < 1
                wait = min(wait, _OFTEN if steps < 1 else steps)
        self.steps_until_update = max(1, int(wait))


def _compute_speed(model: Model) -> float:
    twist = model.twist()
    return math.hypot(*twist.linear) + math.hypot(*twist.angular)


def _compute_steps(
    boxes: Iterable[BoundingBox], solids: Iterable[BoundingBox | HalfSpace], speed: float, dt: float
) -> float:
    """Return the number of steps of `dt` s after which a box may touch one of the `solids`.

    `speed` (m/s) is the speed at which they approach each other.
    """
    gap = min((other.gap(one) for one in boxes for other in solids), default=_FAR)
    return (gap - _CONTACT_DISTANCE) / ((speed + _SPEED_MARGIN) * dt)
