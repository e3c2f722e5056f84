"""If a scheme leads the camera astray, neither camera nor target is reported as the cause."""

import pytest

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run

TASK = {
    "camera": {"width": 320, "height": 240, "horizontal_fov": 0.761, "update_rate": 25.0},
    "target": {"shape": [[-0.1, -0.1], [0.1, -0.08], [0.08, 0.1], [-0.06, 0.06]]},
    "goal": {"pose": [0, 0, -0.6, 0, 0, 0]}, "gain": 2.0, "duration": 2.0,
}  # fmt: skip
PICTURES = {"plant": "free", "features": "images"}
EXACT = {"plant": "ideal", "features": "exact",
         "ideal": {"speed": [1.0, 1.5], "unbounded": True}}  # fmt: skip


@pytest.mark.parametrize(("scheme", "interaction", "turn", "seed", "plant"), [
    ("numbered_points", "desired", 90.0, 0, PICTURES),
    ("numbered_points", "desired", 180.0, 7, PICTURES),
    ("partitioned", "current", 90.0, 0, PICTURES),
    ("moments_six", "desired", 180.0, 1, PICTURES),
    ("moments_six", "desired", 180.0, 2, PICTURES),
    ("moments_six", "mean", 180.0, 3, PICTURES),
    ("moments_six", "current", 180.0, 3, EXACT),
    ("moments_six", "desired", 180.0, 11, EXACT),
])  # fmt: skip
def test_nothing_untrue_is_said_of_camera_and_target(scheme, interaction, turn, seed, plant):
    options = {"hold": 0.4} | ({} if interaction == "current" else {"interaction": interaction})
    result = run(Experiment.from_mapping({
        **TASK, **plant, "scheme": scheme, "controller_parameters": options, "seed": seed,
        "start": {"kind": "turned", "angle": turn, "scatter": [0.01, 2.0]},
    }))  # fmt: skip
    said = " ".join([result.outcome, result.reason, *(state.reason for state in result.states)])
    assert "wrong_camera_model" not in said and "wrong_object" not in said
    for untrue in ("covered the target", "is not the goal's target", "do not move as L",
                   "the target moved"):  # fmt: skip
        assert untrue not in said, said
