"""What all sensors of motion and forces have in common: when they measure, and their noise."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np

from aras_sim_bridge.description import SensorDescription
from aras_sim_bridge.world import Model, World
from aras_visual_servo_base.poses import Vector3

State = TypeVar("State")
_BIAS, _NOISE = 0, 1  # two random sequences: the bias of a run, the noise of each reading


class RateSensor(ABC, Generic[State]):
    """Measures at the first tick at or after k / rate s of simulated time, k = 1, 2, ...; at every
    tick where the rate is 0. A reading may need the state some time before: `_span_ns`, one tick
    where that is 0.

    The simulation calls `before_step` and `after_step` around each step while the sensor is
    `enabled`; steps that end up to `idle_until_ns` need no such calls.

    Attributes:
        description, model: what measures, and where.
        on_state: gets each reading; None: nobody wants them, and nothing is measured.
    """

    _span_ns = 0

    def __init__(self, description: SensorDescription, model: Model, world: World, seed: int
                 ) -> None:
        """`seed` is at least 0; it and the stamps are all that noise depends on."""
        self.description = description
        self.model = model
        self._world = world
        self._seed = seed
        channels = description.channels
        random = np.random.default_rng([seed, _BIAS])
        self._mean, self._stddev = np.zeros(6), np.full(6, description.noise)
        for i, one in enumerate(channels):
            bias = random.normal(one.bias_mean, one.bias_stddev) * random.choice((-1.0, 1.0))
            self._mean[i] = one.mean + bias
            self._stddev[i] = np.hypot(self._stddev[i], one.stddev)
        self._listener: Callable[[object], None] | None = None
        self._is_new = True
        self._due_ns = 0
        self._previous_state: tuple[int, State] | None = None

    @property
    def on_state(self) -> Callable[[object], None] | None:
        return self._listener

    @on_state.setter
    def on_state(self, listener: Callable[[object], None] | None) -> None:
        self._is_new = self._is_new or self._listener is None
        self._listener = listener

    @property
    def enabled(self) -> bool:
        """Whether readings are wanted."""
        return self._listener is not None

    @property
    def idle_until_ns(self) -> int:
        """Up to when, ns, steps may end without a call around each."""
        if self._is_new:
            return 0
        return self._due_ns - 1 - (self._span_ns if self._previous_state is None else 0)

    def reset(self) -> None:
        """Begin anew with the next step: the clock jumped."""
        self._is_new = True

    def before_step(self, time_ns: int, after_ns: int) -> None:
        """Before the step from `time_ns` to `after_ns`."""
        if self._is_new:
            self._is_new, self._previous_state = False, None
            self.model.applied_forces.clear()
            self._schedule_next(after_ns)
            return
        span_ns = max(self._span_ns, after_ns - time_ns)
        if self._previous_state is None and time_ns + span_ns >= self._due_ns:
            self._previous_state = (time_ns, self._read_state())
        self._observe_step(self._due_ns <= after_ns)

    def after_step(self, time_ns: int) -> None:
        """After a step that ended at `time_ns`."""
        if self._is_new or time_ns < self._due_ns:
            return
        if self._previous_state is not None and self._listener is not None:
            before_ns, before = self._previous_state
            reading = self._measure(before, time_ns, (time_ns - before_ns) * 1e-9)
            self._listener(reading)
        self._previous_state = None
        self._schedule_next(time_ns)

    def _schedule_next(self, time_ns: int) -> None:
        """The next reading is the first one after `time_ns`."""
        rate = self.description.rate
        if rate == 0.0:
            self._due_ns = time_ns + 1
            return
        index = int(time_ns * rate / 1e9)
        while round(index * 1e9 / rate) <= time_ns:
            index += 1
        self._due_ns = round(index * 1e9 / rate)

    def _observe_step(self, last: bool) -> None:
        """Look at what acts in the coming step; `last`: the reading comes after it."""

    @abstractmethod
    def _read_state(self) -> State:
        """What a reading needs of the time before it."""

    @abstractmethod
    def _measure(self, before: State, time_ns: int, seconds: float) -> object:
        """The reading at `time_ns`, so many seconds after the state `before`."""

    def _add_noise(self, first: Vector3, second: Vector3, stamp_ns: int) -> tuple[Vector3, Vector3]:
        """Two vectors with the noise of their six channels."""
        if not (self._mean.any() or self._stddev.any()):
            return first, second
        random = np.random.default_rng([self._seed, stamp_ns, _NOISE])
        values = np.array([*first, *second]) + random.normal(self._mean, self._stddev)
        return tuple(values[:3].tolist()), tuple(values[3:].tolist())
