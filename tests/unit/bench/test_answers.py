"""Joint states processed in compiled code give the same run as joint states processed in Python."""

import numpy as np
import pytest

from aras_visual_servo_bench import Experiment, Loop, assemble
from aras_visual_servo_bench.experiment.experiment import TargetSpec
from aras_visual_servo_controller.observation.frame import Frame

LATE = {"controller_parameters": {"lead": 0.002, "lag": 0.001}}
ENDS = {"duration": 4.0, "time_after_convergence": 0.1, "gain": 8.0,
        "controller_parameters": {"hold": 0.1}}  # fmt: skip
RUNS = {
    "as shipped": {},
    "two answers under way": {"delay": 0.06},
    "two features": {"scheme": "gravity_centre", "delay": 0.02},
    "limited": {"controller_parameters": {"max_acceleration": 2.0}},
    "late joints": LATE,
    "fewer joints than it has": {"controller_parameters": {"joints": ["J1", "J2", "J3", "J6"]}},
    "no pictures": {"features": "exact", "delay": 0.01},
    "another plane": {"target": TargetSpec(shape="square", pose=(0.05, 0, 0.591, 0, 0, 0.4))},
    "it ends on the way": ENDS,
    "arm at a limit": {"plant": "chain", "start": "2015", "gain": 12.0},
    "arm with velocities": {"plant": "chain", "controller_parameters": {"output": "velocity"}},
    "two tasks under way": {"plant": "chain", "delay": 0.06},
    "free camera with positions": {"plant": "free", "controller_parameters": {
        "output": "position"}},
    "free camera, wrongly mounted": {"plant": "free", "calibration_offset": {
        "xyz": [0.01, 0.0, 0.02], "rpy": [0.05, 0.0, 0.1]}},
    "free camera that ends on the way": {"plant": "free", **ENDS},
}  # fmt: skip


def finish(experiment, **watched):
    loop = Loop(experiment, assemble(experiment), **watched)
    loop.run_to_end()
    done = loop.make_run()
    loop.close()
    return done


@pytest.mark.parametrize("options", RUNS.values(), ids=RUNS)
def test_a_run_is_the_same_to_the_bit_whoever_answers_the_joint_states(options):
    experiment = Experiment(**{"duration": 0.4, "time_after_convergence": None, **options})
    heard = []
    joined = finish(experiment)
    single = finish(experiment, on_joint_state=lambda loop, reading: heard.append(reading.stamp))
    assert len(heard) >= len(single.joint_stamp) > 20
    for name in ("joint_stamp", "measured_positions", "measured_velocities", "joint_commands",
                 "pose", "true_pose"):  # fmt: skip
        np.testing.assert_array_equal(getattr(joined, name), getattr(single, name), name)
    for one, other in zip(joined.states, single.states, strict=True):
        assert (one.stamp, one.phase, one.reason, one.outcome) == (
            other.stamp, other.phase, other.reason, other.outcome
        )  # fmt: skip
        np.testing.assert_array_equal(one.command, other.command)
    assert (joined.outcome, joined.reason) == (single.outcome, single.reason)


@pytest.mark.parametrize("plant", ["bullet", "chain", "free"])
def test_joint_states_between_two_images_are_processed_in_compiled_code(plant):
    experiment, readings = Experiment(plant=plant), []
    loop = Loop(experiment, assemble(experiment))
    for _ in range(3):
        loop.run_to_image()
    while len(readings) < 3:
        readings += loop.plant.advance(10**9)
    loop.close()
    assert all(isinstance(reading, Frame) for reading in readings)
