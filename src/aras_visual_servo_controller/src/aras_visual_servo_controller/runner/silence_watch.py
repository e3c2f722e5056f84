"""Detection of missing inputs of the loop: joint states, images, and the progress of the clock."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from ..loop.servo import Servo
from ..records.outcomes import Outcome, make_outcome
from ..records.state import HOLDING, STOPPED, WAITING, ImageSource, ServoState
from ..settings import ControllerSettings

# A clock that has not advanced for this wall time, s, is reported as stopped.
STOPPED_CLOCK_TIME = 0.5
RESUME_ADVICE = "resume the simulation, or start the simulator again"


class SilenceWatch:
    """Wall times at which the inputs of the loop last arrived, for reports of missing inputs.

    Attributes:
        sources: source of each camera's images, by camera.
        joints_time: wall time of the latest joint state, s.
        image_times: wall time of the latest image of each camera, s, by camera.
        clock_moved_time: wall time at which the clock last advanced, s.
        stamps_ahead: time by which the stamp of a camera's latest image is ahead of the clock, s,
            by camera, if the image was ignored for this reason.
    """

    def __init__(
        self,
        servo: Servo,
        settings: ControllerSettings,
        joints_source: ImageSource,
        cameras: Iterable[str],
        wall_clock: Callable[[], float],
    ) -> None:
        """Start to wait for the joint states and for the images of `cameras`."""
        self._servo, self._settings, self._joints_source = servo, settings, joints_source
        self._wall_clock = wall_clock
        self.sources: dict[str, ImageSource] = {}
        self.joints_time = self.clock_moved_time = wall_clock()
        self.image_times = dict.fromkeys(cameras, wall_clock())
        self.stamps_ahead: dict[str, float] = {}
        self._report_time = -np.inf

    def describe_stopped_clock(self, now: float) -> str:
        """Return a text that says at which time the clock has stopped; '' if it advances.

        `now` is the time of the clock, s.
        """
        if self._wall_clock() - self.clock_moved_time < STOPPED_CLOCK_TIME:
            return ""
        return f"the clock has stopped at {now:.3f} s (is the simulator paused, or gone?)"

    def make_outcome(self, kind: str, reason: str, now: float) -> Outcome:
        """Return the outcome while no inputs are received.

        If the clock has stopped, the remedy of the outcome says how to make it run again.
        """
        found = make_outcome(kind, reason)
        return found.with_remedy(RESUME_ADVICE) if self.describe_stopped_clock(now) else found

    def report_missing_inputs(self, now: float) -> ServoState | None:
        """Return a state that says which inputs are missing, once per second; otherwise None."""
        servo, settings, wall = self._servo, self._settings, self._wall_clock()
        missing, kind = [], "too_few_images"
        if wall - self.joints_time > settings.joint_timeout:
            kind = "no_joint_states"
            missing.append(self._joints_source.describe_silence())
        for camera, image_time in self.image_times.items():
            if wall - image_time > settings.image_timeout and not servo.is_approaching:
                source = self.sources.get(camera, servo.source)
                ahead = self.stamps_ahead.get(camera)
                missing.append(
                    source.describe_silence()
                    if ahead is None
                    else source.describe_stamp_lead(ahead)
                )
        if not missing or wall - self._report_time < 1.0 or servo.phase == STOPPED:
            return None
        stopped_clock = self.describe_stopped_clock(now)
        phase = HOLDING if servo.phase == HOLDING else WAITING
        is_certain = servo.outcome.kind == kind and len(missing) == 1
        if is_certain and not (stopped_clock or self.stamps_ahead or settings.lockstep) and (
            phase == (HOLDING if kind == "no_joint_states" else WAITING)
        ):  # fmt: skip
            return None  # the reports of the state already say which input is missing
        self._report_time = wall
        reason = "; ".join(filter(None, (stopped_clock, " and ".join(missing))))
        found = self.make_outcome(kind, reason, now)
        return ServoState(now, phase, found.kind, reason, found.remedy)
