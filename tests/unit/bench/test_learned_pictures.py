"""Networks: the camera's pose from an image, the scheme of moments, and the policy."""

from pathlib import Path

import numpy as np
import pytest

from aras_visual_servo_base.poses import exponential, inverse, logarithm
from aras_visual_servo_bench import Experiment, Study, run
from aras_visual_servo_bench.cli.run import find_study_file
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.learning import learned_pose, policy
from aras_visual_servo_bench.learning import learned_scheme as learned
from aras_visual_servo_bench.learning.learned_pose import LearnedPose, PoseNetwork, make_inputs
from aras_visual_servo_bench.learning.policy import Policy, PolicyNetwork
from aras_visual_servo_controller import ConfigurationError, Goal, Observation
from aras_visual_servo_controller.schemes import FeatureScheme

BY_MOMENTS = "aras_visual_servo_bench.learning.learned_scheme:LearnedScheme"
BY_POLICY = "aras_visual_servo_bench.learning.policy:Policy"


def run_learned():
    study = Study.from_yaml(find_study_file(Path("convergence_domain")))
    names = [(case.names["scheme"], case.names["condition"]) for case in study.combinations]
    return run(study.make_experiment(names.index(("learned pose", "clean")) * study.repeats))


def test_without_weights_one_line_says_how_to_make_them(monkeypatch, tmp_path):
    monkeypatch.setenv("ARAS_LEARNED_POSE_WEIGHTS", str(tmp_path / "none.npz"))
    with pytest.raises(ExperimentError, match="no file .*none.npz; to train it, run: python3 -m"):
        run_learned()
    (tmp_path / "bad.npz").write_text("no numbers")
    with pytest.raises(ConfigurationError, match="does not contain a network"):
        PoseNetwork.load(tmp_path / "bad.npz")
    monkeypatch.setenv("ARAS_POLICY_WEIGHTS", str(tmp_path / "none.npz"))
    with pytest.raises(ConfigurationError, match="the policy is missing: .*learning.policy"):
        Policy()
    monkeypatch.undo()
    with pytest.raises(ExperimentError, match="needs images"):
        run(Experiment(plant="free", scheme=BY_POLICY))


def test_brightness_and_contrast_are_no_matter():
    grey = np.random.default_rng(0).integers(0, 120, (48, 64)).astype(np.uint8)
    plain = make_inputs(grey)
    assert plain.shape == (learned_pose.ROWS * learned_pose.COLUMNS,)
    assert (plain.mean(), plain.std()) == pytest.approx((0.0, 1.0), abs=1e-9)
    assert np.abs(make_inputs(grey * 2 + 10) - plain).max() < 0.06
    assert not make_inputs(np.full((48, 64), 90, np.uint8)).any()


def test_s_and_its_rate_are_those_of_the_poses_that_it_tells(tmp_path, monkeypatch, pinhole):
    def answering(motion):
        count = learned_pose.ROWS * learned_pose.COLUMNS
        np.savez(tmp_path / "w.npz", mean=np.zeros(count), scale=np.ones(count), out_mean=motion,
                 out_scale=np.ones(6), w0=np.zeros((count, 6)), b0=np.zeros(6))  # fmt: skip
        return LearnedPose()

    monkeypatch.setenv("ARAS_LEARNED_POSE_WEIGHTS", str(tmp_path / "w.npz"))
    image = np.zeros((pinhole.height, pinhole.width), np.uint8)
    seen = Observation(0.0, 0.0, True, "", pinhole, None, np.eye(4), image=image)
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
    ends = [[at(exponential(now) @ exponential(step * v)).s for v in np.eye(6)]
            for step in (1e-6, -1e-6)]  # fmt: skip
    assert pytest.approx(np.subtract(*ends).T / 2e-6, abs=1e-7) == found.L
    with pytest.raises(ConfigurationError, match="contains no learned_pose: teach it again"):
        feature.check(Goal.teach(None, seen, depth=0.6))


def test_unseen_starts_converge():
    assert run_learned().outcome == "converged"
    experiment = Experiment(
        plant="ideal", features="exact", goal="2016", start=learned.TRAINING_STARTS, gain=2.0,
        scheme=BY_MOMENTS, duration=8.0, reached=(1e-3, 0.01), controller_parameters={"hold": 0.4},
    )  # fmt: skip
    seeded = (experiment.with_changes(seed=seed) for seed in range(500, 503))
    assert all(run(one).verdict.is_reached for one in seeded)
    for seed in (71, 72):
        done = run(Experiment(scheme=BY_POLICY, gain=3.0, start=policy.TRAINING_STARTS, seed=seed,
                              time_after_convergence=0.0, reached=(0.005, 0.0174)))  # fmt: skip
        assert done.outcome == "converged" and done.verdict.is_reached, (seed, done.reason)


def test_what_it_practises_on_belongs_together():
    x, y = policy.collect_demonstrations(None, 240, seed=2, environments=2)
    assert len(x) == len(y) >= 240 and x.shape[1] == policy.ROWS * policy.COLUMNS
    np.testing.assert_allclose(np.hypot(y[:, 3], y[:, 4]), 1.0, atol=1e-3)
    far = np.linalg.norm(y[:, :3], axis=1)
    assert far[:2].min() > 0.02 and np.sort(far)[:20].max() < 0.03
    network = PolicyNetwork(PolicyNetwork.train(x[::2], y[::2]))
    found = np.array([network(row) for row in x[1::2]])
    assert np.median(policy.compute_errors(found, y[1::2])[0]) < 0.05
