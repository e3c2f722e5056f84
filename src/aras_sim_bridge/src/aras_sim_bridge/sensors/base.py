"""Base class of the motion and force sensors: measurement times and noise."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np

from aras_sim_bridge.description import SensorDescription
from aras_sim_bridge.world import Model, World
from aras_visual_servo_base.poses import Vector3

State = TypeVar("State")
# Added to the seed of a sensor, these numbers give two independent random sequences: _BIAS for the
# constant bias of the sensor, _NOISE for the noise of each reading.
_BIAS, _NOISE = 0, 1


class PeriodicSensor(ABC, Generic[State]):
    """Sensor that measures at a fixed rate of simulated time.

    The k-th reading is taken after the first step that ends at or after the time k / rate. With a
    rate of 0, a reading is taken after every step. A sensor that measures a rate of change needs an
    earlier state of the model. This state is stored `_span_ns` before the reading, or one step
    before it if `_span_ns` is 0.

    The simulation calls `before_step` and `after_step` around each step while the sensor is
    `enabled`. It may leave out the calls for steps that end at or before `idle_until_ns`.

    Attributes:
        description: settings of the sensor.
        model: model that the sensor belongs to.
        on_state: function that is called with each reading; if None, the sensor does not measure.
    """

    _span_ns = 0

    def __init__(self, description: SensorDescription, model: Model, world: World, seed: int
                 ) -> None:
        """Create a sensor; its noise depends only on `seed` (≥ 0) and the time of a reading."""
        self.description = description
        self.model = model
        self._world = world
        self._seed = seed
        channels = description.channels
        random = np.random.default_rng([seed, _BIAS])
        self._mean, self._stddev = np.zeros(6), np.full(6, description.noise)
        for i, channel in enumerate(channels):
            bias = random.normal(channel.bias_mean, channel.bias_stddev)
            bias *= random.choice((-1.0, 1.0))
            self._mean[i] = channel.mean + bias
            self._stddev[i] = np.hypot(self._stddev[i], channel.stddev)
        self._listener: Callable[[object], None] | None = None
        self._is_new = True
        self._due_ns = 0
        self._previous_state: tuple[int, State] | None = None
        self._prepare()

    def _prepare(self) -> None:
        """Compute what all readings need; the constructor calls this last."""

    @property
    def on_state(self) -> Callable[[object], None] | None:
        return self._listener

    @on_state.setter
    def on_state(self, listener: Callable[[object], None] | None) -> None:
        self._is_new = self._is_new or self._listener is None
        self._listener = listener

    @property
    def enabled(self) -> bool:
        """Whether the sensor has a listener and therefore measures."""
        return self._listener is not None

    @property
    def idle_until_ns(self) -> int:
        """Simulated time, ns, up to which `before_step` and `after_step` need not be called."""
        if self._is_new:
            return 0
        return self._due_ns - 1 - (self._span_ns if self._previous_state is None else 0)

    def reset(self) -> None:
        """Restart the measurement with the next step, because the simulated time has jumped."""
        self._is_new = True

    def before_step(self, time_ns: int, after_ns: int) -> None:
        """Store the state of the model if the next reading needs the state before this step.

        The step goes from `time_ns` to `after_ns`.
        """
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
        """Take a reading if one is due. Call this after the step that ended at `time_ns`."""
        if self._is_new or time_ns < self._due_ns:
            return
        if self._previous_state is not None and self._listener is not None:
            before_ns, before = self._previous_state
            reading = self._measure(before, time_ns, (time_ns - before_ns) * 1e-9)
            self._listener(reading)
        self._previous_state = None
        self._schedule_next(time_ns)

    def _schedule_next(self, time_ns: int) -> None:
        """Set the time of the next reading to the first multiple of 1 / rate after `time_ns`."""
        rate = self.description.rate
        if rate == 0.0:
            self._due_ns = time_ns + 1
            return
        index = int(time_ns * rate / 1e9)
        while round(index * 1e9 / rate) <= time_ns:
            index += 1
        self._due_ns = round(index * 1e9 / rate)

    def _observe_step(self, last: bool) -> None:
        """Record the forces on the model before a step.

        last: whether a reading follows this step.
        """

    def _read_state(self) -> State:
        """Return the state before a step from which a later reading is computed, if there is one.
        """

    @abstractmethod
    def _measure(self, before: State, time_ns: int, seconds: float) -> object:
        """Return the reading at `time_ns`; `before` is the state `seconds` earlier."""

    def _add_noise(self, first: Vector3, second: Vector3, stamp_ns: int) -> tuple[Vector3, Vector3]:
        """Return the two vectors of a reading after adding noise to their six components."""
        if not (self._mean.any() or self._stddev.any()):
            return first, second
        random = np.random.default_rng([self._seed, stamp_ns, _NOISE])
        values = np.array([*first, *second]) + random.normal(self._mean, self._stddev)
        return tuple(values[:3].tolist()), tuple(values[3:].tolist())
