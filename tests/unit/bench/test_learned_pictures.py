"""Pose predicted from an image by a network: weights, rate, final pose."""

from pathlib import Path

import numpy as np
import pytest

from aras_visual_servo_base.poses import exponential, inverse, logarithm
from aras_visual_servo_bench.cli.run import find_study_file
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.learning import learned_pose
from aras_visual_servo_bench.learning.learned_pose import LearnedPose, PoseNetwork, make_inputs
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_controller.errors import ConfigurationError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.observation import Observation
from aras_visual_servo_controller.schemes import FeatureScheme


def planned(seeds):
    """Runs of the protocol's learned case, clean."""
    study = Study.from_yaml(find_study_file(Path("convergence_domain")))
    names = [(case.names["scheme"], case.names["condition"]) for case in study.combinations]
    first = names.index(("learned pose", "clean")) * study.repeats
    return (study.make_experiment(first + seed) for seed in sorted(seeds))


def test_without_weights_one_line_says_how_to_make_them(monkeypatch, tmp_path):
    monkeypatch.setenv("ARAS_LEARNED_POSE_WEIGHTS", str(tmp_path / "none.npz"))
    with pytest.raises(ExperimentError, match="no file .*none.npz; to train it, run: python3 -m"):
        run(next(planned({0})))
    (tmp_path / "bad.npz").write_text("no numbers")
    with pytest.raises(ConfigurationError, match="does not contain a network"):
        PoseNetwork.load(tmp_path / "bad.npz")


def test_brightness_and_contrast_are_no_matter():
    grey = np.random.default_rng(0).integers(0, 120, (48, 64)).astype(np.uint8)
    plain = make_inputs(grey)
    assert plain.shape == (learned_pose.ROWS * learned_pose.COLUMNS,)
    assert plain.mean() == pytest.approx(0.0, abs=1e-12)
    assert plain.std() == pytest.approx(1.0)
    assert np.abs(make_inputs((grey * 2 + 10).astype(np.uint8)) - plain).max() < 0.06
    assert not make_inputs(np.full((48, 64), 90, np.uint8)).any()


@pytest.fixture
def answering(tmp_path, monkeypatch):
    """Function that makes the feature whose network returns a pose (6,) for any image."""
    def make(motion):
        count = learned_pose.ROWS * learned_pose.COLUMNS
        np.savez(tmp_path / "w.npz", mean=np.zeros(count), scale=np.ones(count), out_mean=motion,
                 out_scale=np.ones(6), w0=np.zeros((count, 6)), b0=np.zeros(6))  # fmt: skip
        monkeypatch.setenv("ARAS_LEARNED_POSE_WEIGHTS", str(tmp_path / "w.npz"))
        return LearnedPose()

    return make


@pytest.fixture
def seen(pinhole):
    image = np.zeros((pinhole.height, pinhole.width), np.uint8)
    return Observation(0.0, 0.0, True, "", pinhole, None, np.eye(4), image=image)


def test_s_and_its_rate_are_those_of_the_poses_that_it_tells(answering, seen):
    at_goal, now = np.array([0.02, -0.01, 0.0, 0.1, 0.05, -0.1]), [0.3, -0.2, 0.1, 0.4, -0.3, 0.7]
    feature = answering(at_goal)
    goal = Goal.teach(FeatureScheme(feature), seen, depth=0.6)
    feature.check(goal)
    assert feature.measure(seen, goal).s == pytest.approx(np.zeros(6))

    def at(pose):
        return answering(logarithm(pose)).measure(seen, goal)

    found = at(exponential(now))
    g_T_c = inverse(exponential(at_goal)) @ exponential(now)
    assert found.s[:3] == pytest.approx(g_T_c[:3, 3])
    assert exponential((0, 0, 0, *found.s[3:]))[:3, :3] == pytest.approx(g_T_c[:3, :3])
    assert found.error == pytest.approx(found.s)
    step = 1e-6
    rows = np.array([
        (at(exponential(now) @ exponential(step * v)).s
         - at(exponential(now) @ exponential(-step * v)).s) / (2 * step)
        for v in np.eye(6)
    ]).T  # fmt: skip
    assert pytest.approx(rows, abs=1e-7) == found.L


def test_a_goal_that_was_taught_for_others_is_refused(answering, seen):
    with pytest.raises(ConfigurationError, match="contains no learned_pose: teach it again"):
        answering(np.zeros(6)).check(Goal.teach(None, seen, depth=0.6))


def test_unseen_starts_converge():
    assert [run(experiment).outcome for experiment in planned({0})] == ["converged"]
