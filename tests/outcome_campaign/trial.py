"""Execution of one trial: its run, the outcome of the loop, and the true result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.recording.run import Run
from aras_visual_servo_bench.runner.loop import Loop
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.studies.remedies import apply_remedy
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.records.outcomes import Outcome
from aras_visual_servo_controller.records.remedy import Remedy

from .kinds import Event, Trial

ONCE = ("hold", "stop")
REFUSED = "refused"  # the experiment could not be made; right where that names what is believed
BELIEVED = "calibration_offset"
EXCESS = 1.5  # largest error of a correct outcome, relative to its uncertainty


@dataclass(frozen=True)
class Judged:
    """Result of a trial.

    said, reason, remedy: the loop's. distance, angle: of the true camera from its goal at the end,
    m and rad. open_distance, open_angle: what 'converged' leaves open, m and rad; NaN without it.
    right: whether what was said is what was written down before. helped: whether the run succeeds
    once its own remedy is applied; None: not tried, or there was nothing to apply.
    """

    kind: str
    number: int
    said: str
    reason: str
    remedy: str
    distance: float
    angle: float
    open_distance: float
    open_angle: float
    right: bool
    helped: bool | None = None

    @property
    def converged(self) -> bool:
        return self.said.startswith("converged")

    @property
    def excess(self) -> float:
        """Larger ratio of the true error to the reported uncertainty, of distance and angle."""
        return max(self.distance / self.open_distance, self.angle / self.open_angle)


class Disturbed:
    def __init__(self, plant: Any, event: Event) -> None:
        self._plant, self._event = plant, event
        self.happened = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def attach_loop(self, *_: Any) -> None:
        """Do nothing, so that compiled control cycles do not bypass the event."""

    def advance(self, until_ns: int) -> list[Any]:
        """Return the readings of the plant, without those that have ended."""
        readings = self._plant.advance(until_ns)
        if not self.happened:
            return readings
        ended = {"images_end": True, "joints_end": False}.get(self._event.what)
        return [r for r in readings if ended is None or isinstance(r, Frame) != ended]

    def command(self, kind: str, values: Any) -> None:
        if not (self.happened and self._event.what == "joints_stick"):
            self._plant.command(kind, values)


def carried_out(keys: Mapping[str, Any], event: Event | None = None) -> tuple[Run, Outcome]:
    """Run an experiment with an event; return the run and the outcome of the loop."""
    experiment = Experiment.from_mapping(keys)
    parts = assemble(experiment)
    if event is not None:
        parts.plant = Disturbed(parts.plant, event)
    loop = Loop(experiment, parts)
    try:
        while not loop.is_over:
            loop.run_to_image()
            if event is not None and not parts.plant.happened and loop.servo_time >= event.at:
                parts.plant.happened = True
                if event.what in ONCE:
                    getattr(loop.servo, event.what)(f"{event.what} was called")
        return loop.make_run(), loop.servo.outcome
    finally:
        loop.close()


def judged(trial: Trial, follow: bool) -> Judged:
    """Run a trial and compare its outcome with the correct outcomes and the truth.

    follow: also apply the remedy of a run that failed, where it changes a setting.
    """
    try:
        run, outcome = carried_out(trial.keys, trial.event)
    except ExperimentError as error:
        right = REFUSED in trial.right and BELIEVED in str(error)
        return Judged(trial.kind, trial.number, REFUSED, str(error), "", *(np.nan,) * 4, right)
    found = _found(trial, run, outcome)
    family = "converged" if found.converged else found.said
    right = family in trial.right and not (found.converged and found.excess > EXCESS)
    helped = None
    if follow and not found.converged and trial.event is None and outcome.remedy.changes:
        helped = _helps(trial, outcome.remedy)
    return replace(found, right=right, helped=helped)


def _found(trial: Trial, run: Run, outcome: Outcome) -> Judged:
    return Judged(
        trial.kind, trial.number, outcome.kind, outcome.reason, outcome.remedy,
        run.verdict.distance, run.verdict.angle, outcome.open_distance, outcome.open_angle,
        right=False,
    )


def _helps(trial: Trial, remedy: Remedy) -> bool:
    try:
        changed = apply_remedy(Experiment.from_mapping(trial.keys), remedy)
        after = _found(trial, *carried_out(changed.to_mapping()))
    except ExperimentError:
        return False
    return after.converged and after.excess <= EXCESS
