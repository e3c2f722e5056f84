"""Diagnosis from the record of a run gives the same result as during the run."""

import contextlib

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
    "free": {"duration": 4.0},
    "free, high gain": {"gain": 12.0, "delay": 0.2},
    "free, noise": {"duration": 2.0, "jitter": 3.0, "scheme": "points"},
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


@pytest.mark.parametrize("options", RUNS.values(), ids=RUNS)
def test_a_record_gives_the_same_outcome_reason_and_remedy(options):
    experiment = Experiment.from_mapping(
        {"plant": "free", "features": "exact", "duration": 3.0, **options})
    loop, told = Loop(experiment, assemble(experiment)), []
    with contextlib.closing(loop):
        while not loop.is_over:
            loop.run_to_image()
            told.append((len(loop.records), loop.servo.outcome))
        loop.make_run()
        told.append((len(loop.records), loop.servo.outcome))
    records, run = loop.records, loop.servo.diagnosis.run_context
    images = [record for record in records if isinstance(record, ImageRecord)]
    assert len(images) > 3
    assert all(one.observation.image is None and one.observation.depth is None for one in images)
    for count, outcome in (*told[:: max(len(told) // 6, 1)], told[-1]):
        # NaN where nothing is known of the distance: compared as text.
        assert repr(diagnose(run, records[:count])) == repr(outcome), count
