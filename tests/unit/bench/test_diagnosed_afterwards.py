"""Diagnosis from the record of a run gives the same result as during the run."""

import contextlib
import functools

import pytest

from aras_visual_servo_bench import Experiment, Loop, assemble
from aras_visual_servo_controller.diagnosis.diagnosis import diagnose
from aras_visual_servo_controller.records.run_record import ImageRecord

SQUARE = {"shape": "square", "size": [0.1, 0.1], "pose": [0, 0, 0.6, 0, 0, 0]}
RUNS = {
    "ideal, half a turn": {"plant": "ideal", "scheme": "points",
                           "start": {"pose": [0.0, 0.0, -0.8, 0.0, 0.0, 3.1]},
                           "goal": {"pose": [0.0, 0.0, -0.6, 0.0, 0.0, 0.0]},
                           "target": {"shape": "square", "size": [0.2, 0.2]}},
    "free": {"duration": 5.0},
    "free, high gain": {"gain": 12.0, "delay": 0.2},
    "free, noise": {"jitter": 3.0, "scheme": "points"},
    "free, wrong camera": {"calibration_offset": {"focal": 2.5}},
    "free, moving target": {"scheme": "points",
                            "target": {**SQUARE, "motion": {"velocity": [0.02, 0, 0, 0, 0, 0]}}},
    "free, hidden": {"features": "images", "duration": 1.0,
                     "target": {**SQUARE, "occluder": [[-0.06, -0.06], [0.06, 0.06]],
                                "occluded": [[0.4, 9.0]]}},
    "free, lost frames": {"features": "images", "duration": 2.0,
                          "camera": {"effects": {"drop_probability": 0.8}, "update_rate": 10.0}},
    "chain": {"plant": "chain", "duration": 3.0},
    "chain, lag": {"plant": "chain", "lag": 1.0, "gain": 5.0},
    "bullet": {"plant": "bullet", "scheme": "points", "duration": 2.0},
}  # fmt: skip


@functools.cache
def finish(name):
    """A loop at the end of a run; the outcome after each image, with the number of records."""
    experiment = Experiment.from_mapping(
        {"plant": "free", "features": "exact", "duration": 4.0, **RUNS[name]})
    loop = Loop(experiment, assemble(experiment))
    told = []
    with contextlib.closing(loop):
        while not loop.is_over:
            loop.run_to_image()
            told.append((len(loop.records), loop.servo.outcome))
        loop.make_run()
        told.append((len(loop.records), loop.servo.outcome))
    return loop, told


@pytest.mark.parametrize("name", RUNS)
def test_a_record_gives_the_same_outcome_reason_and_remedy(name):
    loop, told = finish(name)
    records, run = loop.records, loop.servo.diagnosis.run_context
    assert sum(isinstance(record, ImageRecord) for record in records) > 3
    assert all(record.observation.image is None and record.observation.depth is None
               for record in records if isinstance(record, ImageRecord))  # fmt: skip
    for count, outcome in (*told[:: max(len(told) // 6, 1)], told[-1]):
        found = diagnose(run, records[:count])
        # NaN where nothing is known of the distance: compared as text.
        assert repr(found) == repr(outcome), count


def test_the_runs_that_are_compared_come_to_many_outcomes():
    kinds = {finish(name)[1][-1][1].kind.partition(" ")[0] for name in RUNS}
    assert len(kinds) >= 4, kinds
