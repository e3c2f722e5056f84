"""Remedies of runs are applied to their experiments and improve the runs."""

import pickle
import re
from dataclasses import fields

import numpy as np
import pytest

from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.studies.remedies import apply_remedy
from aras_visual_servo_controller.diagnosis.advice import (
    suggest_faster_joints,
    suggest_gain,
    suggest_larger_target,
    suggest_longer_watchdog,
    suggest_more_time,
    suggest_scheme,
    suggest_wider_limits,
)
from aras_visual_servo_controller.diagnosis.evidence import combine_outcomes
from aras_visual_servo_controller.laws.wrappers import create_law
from aras_visual_servo_controller.records.outcomes import REMEDIES, UNCOVER_TARGET, Outcome
from aras_visual_servo_controller.records.remedy import (
    Remedy,
    SettingChange,
    multiply,
    remove,
    set_value,
)
from aras_visual_servo_controller.schemes.registry import create_scheme
from aras_visual_servo_controller.settings import ControllerSettings

CORNERS = [[-0.05, -0.04], [0.05, -0.05], [0.04, 0.05], [-0.03, 0.03]]
BASE = {
    "plant": "free", "features": "exact", "scheme": "points", "gain": 2.0, "duration": 8.0,
    "target": {"shape": CORNERS, "motion": {"velocity": [0.003, 0, 0, 0, 0, 0]}},
    "goal": {"pose": [0, 0, 0.4, 3.04, 0.15, 0]},
    "start": {"pose": [0.03, -0.04, 0.45, 3.1, 0, 0.2]},
    "calibration_offset": {"depth": 1.2}}  # fmt: skip


def changed(*changes, **keys):
    experiment = Experiment.from_mapping({**BASE, **keys})
    return apply_remedy(experiment, Remedy("advice", *changes)).to_mapping()


def test_a_remedy_is_its_sentence_and_keeps_its_changes():
    made = Remedy("check the arm: whether it moves", multiply("gain", 0.1234),
                  set_value("interaction", "mean"))  # fmt: skip
    assert made.advice == "check the arm: whether it moves"
    assert made == f"{made.advice}: multiply gain by 0.12 and set interaction to mean"
    assert made.changes == (SettingChange("gain", "multiply", 0.12),
                            SettingChange("interaction", "set", "mean"))  # fmt: skip
    again = pickle.loads(pickle.dumps(made))
    assert (again, again.changes, again.advice) == (made, made.changes, made.advice)
    assert not Remedy() and str(remove("calibration_offset")) == "remove calibration_offset"
    assert str(multiply("start", 0.5)) == "multiply the start's offset from the goal by 0.5"
    with pytest.raises(ValueError, match="operation 'add' is unknown; use one of set, mul"):
        SettingChange("gain", "add", 1.0)
    for arguments in (("slow", "slow"), (made,), (made, multiply("gain", 0.5))):
        with pytest.raises(TypeError, match="made of a text and of Changes"):
            Remedy(*arguments)


def test_remedies_are_of_what_there_is():
    first = Outcome("joints_do_not_follow", "one", Remedy("check J1: whether it moves"))
    second = Outcome("gain_too_high", "two", Remedy("lower the gain", multiply("gain", 0.5)))
    found = combine_outcomes(first, second)
    assert found.remedy == "check J1: whether it moves: multiply gain by 0.5"
    assert found.reason == "one; in addition, two"
    for linear in (True, False):  # a loop without a time limit
        assert suggest_more_time(np.inf, 9.0, 0.5, linear).changes == ()
    scheme = create_scheme("points", create_law("adaptive", zero=4.0, infinity=1.0))
    found = suggest_gain(scheme, 2.0, 10.0)
    assert [change.key for change in found.changes] == ["law_options.zero", "law_options.infinity"]
    assert found.count("lower the gain") == 1


@pytest.mark.parametrize("remedy", [
    *REMEDIES.values(), UNCOVER_TARGET, suggest_larger_target(1.5), suggest_larger_target(9.0),
    suggest_wider_limits(["lower"]), suggest_more_time(4.0, 9.0, 0.5),
    suggest_gain(create_scheme("points"), 2.0, 1.0), suggest_gain(None, None, np.inf),
    suggest_gain(create_scheme("points", create_law("adaptive", zero=4.0, infinity=1.0)), 2.0, 4.0),
    suggest_faster_joints(Remedy("help")), suggest_longer_watchdog(0.4, 2.0, 4.0),
    *(suggest_scheme(Outcome(kind), create_scheme(name))
      for kind in ("singular", "camera_retreat", "local_minimum") for name in ("points", "pose"))])
def test_the_text_names_only_keys_that_a_user_of_a_robot_can_set(remedy):
    parameters = {field.name for field in fields(ControllerSettings)}
    named = re.findall(r"\b(?:set|multiply|remove) (\S+)", remedy.removeprefix(remedy.advice))
    assert {key.partition(".")[0] for key in named} - {"the"} <= parameters, remedy
    assert len(named) == sum(change.operation != "remove" or change.key == "lower"
                             for change in remedy.changes)  # fmt: skip


def test_changes_set_multiply_and_remove_keys_of_the_experiment_and_of_the_controller():
    keys = changed(multiply("gain", 0.5), multiply("duration", 2.0), remove("target.motion"),
                   remove("calibration_offset"), set_value("interaction", "mean"))  # fmt: skip
    assert (keys["gain"], keys["duration"]) == (1.0, 16.0)
    assert "motion" not in keys["target"] and "calibration_offset" not in keys
    assert keys["controller_parameters"] == {"interaction": "mean"}
    plain = Experiment.from_mapping({**BASE, "gain": None})
    assert apply_remedy(plain, Remedy("", multiply("gain", 0.5))).gain == 2.5  # of the default
    # of several changes those that apply are made
    assert "motion" not in changed(remove("target.occluder"), remove("target.motion"))["target"]


def test_a_target_grows_and_a_start_comes_nearer():
    keys = changed(multiply("target.size", 2.0), multiply("start", 0.5))
    np.testing.assert_allclose(keys["target"]["shape"], 2.0 * np.array(CORNERS))
    start, goal = np.array(keys["start"]["pose"][:3]), np.array(BASE["goal"]["pose"][:3])
    np.testing.assert_allclose(start, goal + 0.5 * (np.array(BASE["start"]["pose"][:3]) - goal),
                               atol=1e-3)  # fmt: skip
    drawn = changed(multiply("start", 0.5), start={"height": [0.3, 0.5], "side": 0.04, "turn": 0.8})
    assert drawn["start"] == {"height": [0.35, 0.45], "side": 0.02, "turn": 0.4}
    arm = {"plant": "chain", "goal": "2016", "start": "2015", "target": {},
           "calibration_offset": {}}  # fmt: skip
    assert len(changed(multiply("start", 0.5), **arm)["start"]) == 6


@pytest.mark.parametrize(("change", "why"), [
    ((), "changes no setting"),
    ((remove("target.occluder"),), "target.occluder is not set"),
    ((set_value("warp", 1),), "no key 'warp'"),
    ((multiply("scheme", 2.0),), "scheme is 'points': it cannot be multiplied"),
    ((multiply("goal", 0.5),), "reaches every pose")])  # fmt: skip
def test_what_cannot_be_applied_is_refused(change, why):
    with pytest.raises(ExperimentError, match=why):
        changed(*change)


@pytest.mark.parametrize(("keys", "outcome"), [
    ({}, "target_moves"),
    ({"target": {"shape": CORNERS}, "calibration_offset": {"rpy": [0, 0, 2.5]}},
        "wrong_camera_model"),
    ({"target": {"shape": CORNERS}, "gain": 0.4, "duration": 1.5}, "timed_out"),
    ({"target": {"shape": CORNERS}, "delay": 0.3, "gain": 5.0}, "gain_too_high"),
    ({"target": {"shape": CORNERS, "occluder": [[-0.06, -0.06], [-0.01, 0.06]],
                 "occluded": [[0.5, 60.0]]}, "features": "images", "scheme": "moments"},
        "wrong_object")])  # fmt: skip
def test_the_remedy_of_a_run_that_fails_helps(keys, outcome):
    experiment = Experiment.from_mapping({**BASE, "calibration_offset": {}, **keys})
    failed = run(experiment)
    assert failed.outcome == outcome, failed.reason
    assert run(apply_remedy(experiment, failed.remedy)).outcome.startswith("converged")
