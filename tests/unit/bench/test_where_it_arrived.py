"""Runs that end at a wrong pose although every feature has its desired value; steady outcomes."""

import re
from itertools import groupby

import numpy as np
import pytest

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import Loop, run
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_controller.features import Feature, FeatureMeasurement

UNEVEN = [[-0.05, -0.04], [0.05, -0.05], [0.04, 0.05], [-0.03, 0.03]]
# As the camera's image is the goal's from two poses, it goes to the one that is not the goal.
TRIANGLE = {
    "scheme": "segments", "gain": 2.5,
    "camera": {"width": 320, "height": 240, "horizontal_fov": 1.18, "update_rate": 30.0},
    "target": {"shape": "triangle", "size": [0.0636, 0.0636],
               "pose": [0.317, 0.067, 0.967, -1.613, 0.703, -0.971]},
    "goal": {"pose": [0.591, 0.205, 0.965, -1.553, 1.281, 2.057]},
    "start": {"pose": [0.638, 0.150, 1.118, 2.738, 1.104, -0.192]}}  # fmt: skip
# The tilt's mirror image is as good to a long lens.
LONG_LENS = {
    "scheme": "points", "gain": 2.0,
    "camera": {"width": 320, "height": 240, "horizontal_fov": 0.25, "update_rate": 20.0},
    "target": {"shape": [[0.012, 0.009], [-0.012, 0.008], [-0.003, -0.017], [0.011, -0.008]]},
    "goal": {"pose": [0.22, 0.0, 0.73, np.pi, 0.293, 0.0]},
    "start": {"pose": [-0.24, 0.02, 0.75, np.pi, -0.31, 0.1]}}  # fmt: skip


def ran(**keys):
    result = run(Experiment.from_mapping({
        "plant": "free", "features": "exact", "duration": 16.0, "time_after_convergence": 0.0,
        **keys}))  # fmt: skip
    left = result.states[-1].arrival_status.pose_uncertainty
    return result, (np.nan, np.nan) if left is None else (left.distance, left.angle)


@pytest.mark.parametrize("keys", [TRIANGLE, LONG_LENS], ids=["three points", "long lens"])
@pytest.mark.parametrize("rate", [5.0, 30.0])
def test_another_pose_of_the_same_image_is_told_by_kinematics(keys, rate):
    keys = {**keys, "camera": {**keys["camera"], "update_rate": rate}, "gain": min(2.0, rate / 5.0)}
    result, _ = ran(**keys)
    assert result.verdict.distance > 0.02, result.verdict
    assert result.outcome == "ambiguous", result.outcome
    millimetres = float(re.search(r"at one of them, (\S+) mm", result.reason)[1])
    assert millimetres == pytest.approx(1e3 * result.verdict.distance, rel=0.05)
    # begun nearer to the goal it arrives there, and says so
    goal = keys["goal"]["pose"]
    near = (np.array(goal) + [0.004, -0.003, 0.01, 0.01, 0.01, 0.02]).tolist()
    result, bound = ran(**{**keys, "start": {"pose": near}})
    assert result.outcome == "converged" and result.verdict.is_reached
    assert result.verdict.distance <= bound[0] and result.verdict.angle <= bound[1]


class CentreAndSize(Feature):
    """A user's own: the target's middle and the logarithm of its size."""

    names, tolerances, units = ("x", "y", "size"), (0.002,) * 3, ("",) * 3
    directions = (True, True, True, False, False, False)

    def desired(self, moments):
        return moments.xg, moments.yg, 0.5 * np.log(moments.m00)

    def measure(self, observation, goal):
        now = observation.moments
        s = np.array([now.xg, now.yg, 0.5 * np.log(now.m00)])
        wanted = np.array(self.desired(goal.moments))
        Z = goal.depth * np.sqrt(goal.moments.m00 / now.m00)
        x, y, _ = s
        L = [[-1 / Z, 0, x / Z, x * y, -1 - x * x, y], [0, -1 / Z, y / Z, 1 + y * y, -x * y, -x],
             [0, 0, 1 / Z, 1.5 * y, -1.5 * x, 0]]  # fmt: skip
        return FeatureMeasurement(s, wanted, self.error(s, wanted), np.array(L))

    def error(self, s, wanted):
        return s - wanted


class Swapped(CentreAndSize):
    def desired(self, moments):
        return moments.yg, moments.xg, 0.5 * np.log(moments.m00)


class NothingToDo(CentreAndSize):
    def error(self, s, wanted):
        return 0.0 * s


class MiddleAlone(CentreAndSize):
    names, tolerances, units = ("x", "y"), (0.002,) * 2, ("",) * 2
    directions = (True, True, False, False, False, False)

    def measure(self, observation, goal):
        whole = super().measure(observation, goal)
        return FeatureMeasurement(whole.s[:2], whole.desired[:2], whole.error[:2], whole.L[:2])


@pytest.mark.parametrize(("scheme", "is_right"), [
    (CentreAndSize, True), (MiddleAlone, True), (Swapped, False),
    (NothingToDo, False)])  # fmt: skip
def test_the_image_of_an_arrival_is_compared_with_the_goal_s(scheme, is_right):
    result, _ = ran(scheme=f"{__name__}:{scheme.__name__}", gain=2.0,
                    target={"shape": UNEVEN, "pose": [0.06, 0.02, 0, 0, 0, 0]},
                    goal={"pose": [0, 0, 0.4, np.pi, 0, 0]},
                    start={"pose": [0.05, -0.04, 0.45, np.pi, 0, 0]})  # fmt: skip
    if is_right:
        assert result.outcome == "converged" and result.verdict.distance < 1e-3
    else:
        assert result.verdict.distance > 5e-3
        assert (
            result.outcome == "ambiguous" and "the image differs from the goal's" in result.reason)


def test_what_a_scheme_does_not_control_and_the_image_shows_is_left_open():
    """The target is raised towards the camera, which holds its height: no fault of the scheme."""
    result, bound = ran(scheme=f"{__name__}:MiddleAlone", gain=2.0,
                        target={"shape": UNEVEN, "pose": [0.06, 0.02, 0, 0, 0, 0],
                                "motion": {"step": [0.0, 0.0, 0.05], "begin": 0.2}},
                        goal={"pose": [0, 0, 0.4, np.pi, 0, 0]},
                        start={"pose": [0.05, -0.04, 0.4, np.pi, 0, 0]})  # fmt: skip
    assert result.outcome.startswith("converged up to") and "mm" in result.outcome
    assert 0.04 < result.verdict.distance <= bound[0]


@pytest.mark.parametrize(("goal", "scheme", "step", "is_plain"), [
    ("auto", "points", [0.0, 0.0, 0.03], True), ("2016", "moments", [0.03, 0.02, 0.0], True),
    ("2016", "moments", [0.0, 0.0, 0.02], False)])  # fmt: skip
def test_a_target_that_lies_elsewhere_is_what_the_camera_goes_by(goal, scheme, step, is_plain):
    """A goal that was worked out has its target at a height: higher up, or a wrong camera?"""
    result, bound = ran(plant="chain", scheme=scheme, goal=goal, gain=2.0,
                        start={"height": [0.22, 0.28], "side": 0.03, "turn": 0.5},
                        target={"motion": {"step": step, "begin": 0.2}}, seed=3)  # fmt: skip
    assert result.verdict.distance <= bound[0] and result.verdict.is_reached
    assert (result.outcome == "converged") is is_plain
    assert is_plain or "20.1 mm" in result.outcome


def reported(**keys):
    """The states of a run before the 2016 goal whose target is moved after 3 s."""
    experiment = Experiment.from_mapping({
        "plant": "chain", "features": "exact", "goal": "2016", "start": "2016", "duration": 7.0,
        "time_after_convergence": None, **keys})  # fmt: skip
    loop, states = Loop(experiment, assemble(experiment)), []
    while not loop.is_over:
        if (state := loop.run_to_image()) is not None:
            states.append(state)
    loop.close()
    return states


@pytest.mark.parametrize(("scheme", "away"), [("moments", 0.01), ("points", 0.003)])
def test_a_target_just_beyond_reach_is_named_at_once_and_steadily(scheme, away):
    """The goal of 2016 lies 0.1 mm before the straight arm."""
    states = reported(scheme=scheme, target={"motion": {"step": [0, -away, 0], "begin": 3.0}})
    after = [state for state in states if state.stamp > 3.0]
    kinds = [kind for kind, _ in groupby(state.outcome.partition(" ")[0] for state in after)]
    assert kinds in (["converged", "running", "out_of_reach"], ["running", "out_of_reach"])
    first = next(state.stamp for state in after if state.outcome == "out_of_reach")
    assert first < 5.5
    for state in after:
        failed = state.outcome == "out_of_reach"
        assert state.reason.startswith("the arm is stretched") or not failed
        assert ("choose a goal within the arm's reach" in state.remedy) is failed
