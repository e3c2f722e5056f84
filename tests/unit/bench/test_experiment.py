"""An experiment is checked when it is made, and says what is wrong with it in one line."""

import math

import pytest
import yaml

from aras_visual_servo_bench.asked.experiment import CameraPose, Experiment, Sampler
from aras_visual_servo_bench.errors import ExperimentError


def test_defaults_are_the_shipped_demo():
    experiment = Experiment()
    assert (experiment.plant, experiment.camera, experiment.start) == ("bullet", "original", "2016")
    assert experiment.pictures


def test_an_experiment_is_read_from_yaml(tmp_path):
    path = tmp_path / "experiment.yaml"
    path.write_text(yaml.safe_dump({
        "plant": "free",
        "camera": {"horizontal_fov": 2, "width": 640, "height": 480},
        "believed": {"focal": 1.1, "centre": [3, -2]},
        "target": {"shape": [[0, 0], [1, 0], [1, 1]], "motion": {"velocity": [0.1, 0, 0, 0, 0, 0]}},
        "start": {"height": [0.2, 0.3], "tilt": 0.1},
        "goal": {"pose": [0, 0, 0.8, 3.14, 0, 0]},
        "gain": 2,
        "linger": None,
    }))  # fmt: skip
    experiment = Experiment.from_yaml(path)
    assert experiment.start == Sampler(height=(0.2, 0.3), tilt=0.1)
    assert experiment.goal == CameraPose((0.0, 0.0, 0.8, 3.14, 0.0, 0.0))
    assert experiment.gain == 2.0 and isinstance(experiment.gain, float)
    assert experiment.believed.centre == (3.0, -2.0)
    assert not experiment.pictures
    assert experiment.linger is None


def test_keys_with_values_are_taken_by_the_constructor_as_from_a_file():
    values = {"plant": "free", "believed": {"focal": 0.9}, "start": {"height": [0.2, 0.3]},
              "target": {"shape": [[0, 0], [1, 0], [1, 1]]}}  # fmt: skip
    assert Experiment(**values) == Experiment.from_mapping(values)
    with pytest.raises(ExperimentError, match="unknown key 'believed.fokal': did you mean 'focal'"):
        Experiment(believed={"fokal": 0.9})


def test_a_changed_experiment_is_checked_again():
    assert Experiment().with_(gain=2, seed=4).seed == 4
    with pytest.raises(ExperimentError, match="gain is -2"):
        Experiment().with_(gain=-2)


@pytest.mark.parametrize(
    ("values", "complaint"),
    [
        ({"plnt": "free"}, r"unknown key 'plnt': did you mean 'plant'\?"),
        ({"believed": {"focall": 1.0}}, r"'believed.focall': did you mean 'focal'\?"),
        ({"start": {"heigth": [0.2, 0.3]}}, r"'start.heigth': did you mean 'height'\?"),
        ({"plant": "bulet"}, r"plant is 'bulet': did you mean 'bullet'\?"),
        ({"renderer": "exakt"}, r"renderer is 'exakt': did you mean 'exact'\?"),
        ({"commands": "frames"}, "commands is 'frames'"),
        ({"gain": "3"}, "gain is '3', must be a finite number"),
        ({"gain": 0}, "gain is 0.0, must be > 0"),
        ({"gain": math.nan}, "gain is nan, must be a finite number"),
        ({"seed": True}, "seed is True, must be a whole number"),
        ({"seed": -1}, "seed is -1"),
        ({"friction": 1}, "friction is 1, must be true or false"),
        ({"delay": -0.1}, "delay is -0.1"),
        ({"duration": 0}, "duration is 0.0, must be > 0 s"),
        ({"camera_xyz": [1, 2]}, r"camera_xyz is \[1, 2\], must be a list of 3 finite numbers"),
        ({"start": [0, math.inf]}, r"start\[1\] is inf, must be a finite number"),
        ({"start": {"height": [0.3, 0.2]}}, "start.height is 0.3 to 0.2"),
        ({"reached": [0, 0.1]}, r"reached\[0\] is 0.0, must be > 0"),
        ({"features": "exact", "noise": 2.0}, "noise is for pictures: give jitter"),
        ({"target": {"shape": [[0, 0], [1, 0], [0, 1]], "motion": {"step": [1, 0, 0]}}},
         "give its shape a pose"),
        ({"target": {"occluder": [[0, 0], [0.1, 0.1]]}}, "made for another target.shape"),
        ({"plant": "free", "noise": 5}, "give jitter"),
        ({"jitter": 1}, "give noise"),
        ({"plant": "free", "target": {"motion": {"amplitude": [1, 0, 0]}}}, "needs a frequency"),
        ({"plant": "free", "target": {"shape": "squar"}}, "did you mean 'square'"),
        ({"target": {"shape": "square", "size": [9, 9], "pose": [0, 0, 0.591, 0, 0, 0]}},
         r"target.size\[0\] is 9.0, must be <= 2 m, the table's"),
        ({"plant": "free", "traced": True}, "no steps"),
        ({"believed": {"focal": 0}}, "believed.focal is 0"),
        ({"robot": "ur5"}, "robot is 'ur5', must be keys with values"),
        ([], "must be keys with values"),
    ],
)
def test_what_cannot_be_run_is_refused_in_one_line(values, complaint):
    with pytest.raises(ExperimentError, match=complaint) as caught:
        Experiment.from_mapping(values)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_none_or_never_ends_is_refused(tmp_path):
    with pytest.raises(ExperimentError, match="cannot read"):
        Experiment.from_yaml(tmp_path / "none.yaml")
    with pytest.raises(ExperimentError, match="no ordinary file"):
        Experiment.from_yaml("/dev/zero")
    broken = tmp_path / "broken.yaml"
    broken.write_text("gain: [1")
    with pytest.raises(ExperimentError, match="not valid YAML"):
        Experiment.from_yaml(broken)
