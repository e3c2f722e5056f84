"""Experiments are checked when they are made; an error is a one-line message."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml

from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import CameraPoseSpec, Experiment, RandomStart
from aras_visual_servo_bench.targets.geometry import TargetMotion
from aras_visual_servo_bench.targets.target_spec import TargetSpec


def test_an_experiment_is_read_from_yaml(tmp_path):
    path = tmp_path / "experiment.yaml"
    path.write_text("plant: free\ngain: 2\nstart: {height: [0.2, 0.3], tilt: 0.1}\n"
                    "goal: {pose: [0, 0, 0.8, 3.14, 0, 0]}\ntime_after_convergence: null\n")
    experiment = Experiment.from_yaml(path)
    assert experiment.start == RandomStart(height=(0.2, 0.3), tilt=0.1)
    assert experiment.goal == CameraPoseSpec((0.0, 0.0, 0.8, 3.14, 0.0, 0.0))
    assert experiment.gain == 2.0 and isinstance(experiment.gain, float)
    assert experiment.time_after_convergence is None and not experiment.has_images
    path.write_text("gain: [1")
    with pytest.raises(ExperimentError, match="experiment.yaml is not valid YAML"):
        Experiment.from_yaml(path)


SQUARE = [[-0.05, -0.04], [0.05, -0.05], [0.04, 0.05], [-0.03, 0.03]]


class Own:
    pass


@pytest.mark.parametrize(("given", "meant"), [
    ({"target": Path("f.svg")}, {"target": {"shape": "f.svg"}}),
    ({"target": np.array(SQUARE)}, {"target": {"shape": SQUARE}}),
    ({"target": {"shape": SQUARE, "pose": np.zeros(6)}}, {"target": {"shape": SQUARE}}),
    ({"robot": Path("arm.urdf")}, {"robot": {"urdf": "arm.urdf"}}),
    ({"camera": Path("lens.yaml")}, {"camera": "lens.yaml"}),
    ({"camera": {"width": np.int64(320)}}, {"camera": {"width": 320}}),
    ({"cameras": {"left": "wide"}}, {"cameras": {"left": {"model": "wide"}}}),
    ({"goal": {"pose": np.arange(6.0)}}, {"goal": {"pose": [0, 1, 2, 3, 4, 5]}}),
    ({"start": np.ones(6)}, {"start": [1, 1, 1, 1, 1, 1]}), ({"start": 2016}, {"start": "2016"}),
    ({"gain": np.float32(2)}, {"gain": 2.0}), ({"seed": np.int64(3)}, {"seed": 3}),
    ({"scheme": Own}, {"scheme": f"{__name__}:Own"}),
    ({"controller_parameters": {"max_velocity": np.ones(2)}},
     {"controller_parameters": {"max_velocity": [1.0, 1.0]}}),
])  # fmt: skip
def test_values_of_python_stand_for_those_of_a_file(given, meant):
    values = {"plant": "free", **given}
    experiment = Experiment(**values)
    assert experiment == Experiment.from_mapping({"plant": "free", **meant})
    assert Experiment.load(values) == Experiment.load(experiment) == experiment
    text = yaml.safe_dump(experiment.to_mapping())
    assert Experiment.from_mapping(yaml.safe_load(text)) == experiment


@pytest.mark.parametrize("key", [f.name for f in dataclasses.fields(Experiment)])
def test_the_constructor_names_a_key_whose_value_is_of_no_use(key):
    with pytest.raises(ExperimentError, match=rf"^{key}\b.* is .*must be"):
        Experiment(**{key: object()})


def test_what_is_no_experiment_is_named():
    for given in (None, [Experiment()], Experiment, 3):
        with pytest.raises(ExperimentError, match=r"is not an experiment: give Experiment\(...\)"):
            Experiment.load(given)
    with pytest.raises(ExperimentError, match="give values by name"):
        Experiment("free")
    with pytest.raises(ExperimentError, match="cannot be imported: define the class at the top"):
        Experiment(scheme=type("Inner", (), {"__qualname__": "f.<locals>.Inner"}))


def test_with_changes_the_keys_that_it_names_and_nothing_else():
    base = Experiment(
        plant="free", features="images", camera="noisy", scheme="points", seed=3,
        target={"shape": "l_shape", "motion": {"velocity": [0.1, 0, 0, 0, 0, 0]}},
        controller_parameters={"max_velocity": 0.5},
    )  # fmt: skip
    changed = base.with_changes(
        camera={"effects": {"drop_probability": 0.3}}, target={"size": [0.1, 0.1]},
        controller_parameters={"hold": 0.1}, **{"target.motion.begin": 1.0},
    )  # fmt: skip
    assert changed.camera == {"preset": "noisy", "effects": {"drop_probability": 0.3}}
    assert changed.target.shape == "l_shape" and changed.target.size == (0.1, 0.1)
    assert changed.target.motion == TargetMotion(velocity=(0.1, 0, 0, 0, 0, 0), begin=1.0)
    assert changed.controller_parameters == {"max_velocity": 0.5, "hold": 0.1} and changed.seed == 3
    assert base.with_changes(target=TargetSpec(shape="square")).target == TargetSpec(shape="square")
    assert base.with_changes(start={"side": 0.2}).start == RandomStart(side=0.2)


@pytest.mark.parametrize("changes, text", [
    ({"gian": 2}, "gain"), ({"target.sise": 2}, "target.sise"), ({"target": {"sise": 2}}, "size"),
    ({"gain.x": 1}, "gain"), ({"scheme.x": 1}, "scheme"), ({"gain": -2}, "gain is -2"),
])  # fmt: skip
def test_with_names_a_key_that_there_is_not(changes, text):
    with pytest.raises(ExperimentError, match=text):
        Experiment(gain=2.0, scheme="points").with_changes(**changes)


@pytest.mark.parametrize(("values", "complaint"), [
    ({"calibration_offset": {"focal": 400}}, "focal is 400.0, must be <= 10, the ratio of the"),
    ({"calibration_offset": {"rpy": [5, 0, 0]}}, r"rpy\[0\] is 5.0.*5 degrees are 0.08727 rad"),
    ({"camera_rpy": [0, 10, 0]}, r"camera_rpy\[1\] is 10.0, must be <= 3.142 rad"),
    ({"delay": 15}, r"delay is 15.0, must be <= 10 s \(15 ms are 0.015 s\)"),
    ({"controller_parameters": {"gain": 2}},
     "controller_parameters.gain cannot be set: set the experiment.s key gain"),
    ({"features": "exact", "noise": 2.0}, "noise acts only on images, .*: set jitter"),
    ({"jitter": 1}, "set noise"), ([], "must be a mapping"),
])  # fmt: skip
def test_what_cannot_be_run_is_refused_in_one_line(values, complaint):
    with pytest.raises(ExperimentError, match=complaint) as caught:
        Experiment.from_mapping(values)
    assert "\n" not in str(caught.value)
