"""Who makes the steps of a bolted model: its own dynamics, or Bullet while something may touch it.

Own steps (joint_dynamics.py) take a tenth of Bullet's time and are exact; and a model that makes
them moves to the last bit as if it were alone. So from time to time the boxes of all that may come
near are looked at, as seldom as speeds allow. Bullet keeps what it holds of such a model asleep,
where it stood at the last look: nothing gets there before the next one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from aras_sim_bridge.world.model import Model
from aras_sim_bridge.world.reach import MARGIN, Box, HalfSpace, can_meet, compute_reach, find_solids

_CONTACT_DISTANCE = 0.02  # m between boxes: whoever is nearer may touch in the next step
# m/s, on top of all speeds seen: what pushes and accelerates between two looks may add.
_SPEED_MARGIN = 5.0
_RETURN_STEPS = 8  # steps' travel that has to be free before a model makes its own steps again
_FAR = 1e9  # m
_ARM_LENGTH = 2.0  # m, of another robot, whose joints' speeds are known
# steps between looks: once Bullet has the model, with something within its reach, outside it
_OFTEN, _WITHIN, _SELDOM, _NEVER = 10, 20, 100, 1 << 60


@dataclass(eq=False)
class IsolatedModel:
    """A bolted model with joints.

    reach: what its moved links never leave. links: their indices in Bullet. grounds: bolted
    models that they may touch.
    """

    model: Model
    reach: tuple[Box, ...]
    links: frozenset[int]
    nearby_models: tuple[Model, ...]

    def compute_boxes_and_speed(self) -> tuple[list[Box], float]:
        """Boxes of the moved links as they stand; more than the speed of any of their points, m/s.
        """
        boxes = find_solids(self.model, self.links)
        root = self.model.pose().xyz
        corners = [(*low, *high) for low, high in (*boxes, Box(root, root))]
        extent = math.dist(*(tuple(map(pick, zip(*corners, strict=True)))[part]
                             for pick, part in ((min, slice(0, 3)), (max, slice(3, 6)))))
        return boxes, sum(map(abs, self.model.read_joints()[1])) * max(1.0, extent)

    def compute_isolated_steps(
        self, loose: list[list[Box | HalfSpace]], fastest: float, dt: float
    ) -> float:
        """Steps of `dt` s in which nothing can touch the moved links.

        Args:
            loose: solids of the loose models. fastest: the greatest speed among them, m/s.
        """
        if not (loose or self.nearby_models):
            return _NEVER
        far = min(
            (_compute_steps(self.reach, solid, fastest, dt) for solid in loose), default=_SELDOM
        )
        if far >= _SELDOM and not self.nearby_models:  # of all that the model can ever reach
            return _SELDOM
        boxes, speed = self.compute_boxes_and_speed()
        near = [_compute_steps(boxes, solid, speed + fastest, dt) for solid in loose]
        for other in self.nearby_models:
            both = speed + sum(map(abs, other.read_joints()[1])) * _ARM_LENGTH
            near.append(
                _compute_steps(boxes, find_solids(other, other.link_indices.values()), both, dt)
            )
        return min(_WITHIN, *near)


class IsolationMonitor:
    """Looks at what may touch the bolted models of a world.

    Attributes:
        bolted: the models with joints that may make steps of their own.
        wait: steps until `update` is due.
        touchable: whether something loose may touch the base of a model that is held.
    """

    def __init__(self, models: Mapping[str, Model], window: bool) -> None:
        """`window`: Bullet makes all steps, for what its window shows is Bullet's."""
        self._models, self._window = models, window
        self.isolated_models: list[IsolatedModel] = []
        self._loose: list[Model] = []
        self.steps_until_update, self.is_base_touchable = 0, False

    def refresh(self) -> None:
        """Models came, went, were bolted or let go."""
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
        """A bolted model was put elsewhere."""
        if model.joint_names:
            self.refresh()
            return
        for island in self.isolated_models:
            if island.model is not model:
                others = tuple(one for one in island.nearby_models if one is not model)
                island.nearby_models = (*others, model) if can_meet(island.reach, model) else others
        self.steps_until_update = 0

    def update(self, dt: float) -> None:
        """Choose for each model, for steps of `dt` s."""
        loose = [find_solids(model, model.link_indices.values()) for model in self._loose]
        fastest = 2.0 * max(map(_compute_speed, self._loose), default=0.0)  # one may strike another
        wait, self.is_base_touchable = _NEVER, False
        for island in self.isolated_models:
            model = island.model
            steps = 0.0 if model.is_attached else island.compute_isolated_steps(loose, fastest, dt)
            own = steps >= (1 if model.joints.has_own_dynamics else _RETURN_STEPS)
            if model.body.is_asleep and not own:  # it wakes in the next step
                model.body.set_asleep(False)
                wait = 1
                continue
            if own and not model.body.is_asleep:
                model.body.set_asleep(True)
            model.joints.set_own_dynamics(own)
            wait = min(wait, steps if own else _OFTEN)
            if model.release is not None and loose:
                base = find_solids(model, model.list_base_links())
                steps = min(_compute_steps(solid, base, fastest, dt) for solid in loose)
                self.is_base_touchable = self.is_base_touchable or steps < 1
                wait = min(wait, _OFTEN if steps < 1 else steps)
        self.steps_until_update = max(1, int(wait))


def _compute_speed(model: Model) -> float:
    twist = model.twist()
    return math.hypot(*twist.linear) + math.hypot(*twist.angular)


def _compute_steps(boxes: Iterable[Box], solids: Iterable[Box | HalfSpace], speed: float,
           dt: float) -> float:
    """Steps of `dt` s that these need at least to come near each other at `speed` m/s."""
    gap = min((other.gap(one) for one in boxes for other in solids), default=_FAR)
    return (gap - _CONTACT_DISTANCE) / ((speed + _SPEED_MARGIN) * dt)
