"""Policy that uses images: training data and final pose."""

import numpy as np
import pytest

from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.learning import policy
from aras_visual_servo_bench.learning.policy import (
    TRAINING_STARTS,
    Policy,
    PolicyNetwork,
)
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_controller.errors import ConfigurationError

SCHEME = "aras_visual_servo_bench.learning.policy:Policy"


def test_it_comes_to_the_goal_from_starts_that_it_has_not_seen():
    for seed in (71, 72):
        done = run(Experiment(scheme=SCHEME, gain=1.5, start=TRAINING_STARTS, seed=seed,
                              reached=(0.005, np.radians(1.0))))  # fmt: skip
        assert done.outcome == "converged" and done.verdict.is_reached, (seed, done.reason)


def test_what_it_practises_on_belongs_together():
    """Answers are where the goal is: a teacher who flies by them comes there."""
    x, y = policy.collect_demonstrations(None, 240, seed=2, environments=2)
    assert len(x) == len(y) >= 240 and x.shape[1] == policy.ROWS * policy.COLUMNS
    np.testing.assert_allclose(np.hypot(y[:, 3], y[:, 4]), 1.0, atol=1e-3)
    far = np.linalg.norm(y[:, :3], axis=1)
    assert far[:2].min() > 0.02 and np.sort(far)[:20].max() < 0.03
    network = PolicyNetwork(policy.train(x[::2], y[::2]))
    found = np.array([network(row) for row in x[1::2]])
    assert np.median(policy.compute_errors(found, y[1::2])[0]) < 0.05


def test_a_goal_that_was_not_shown_to_it_is_refused(monkeypatch, tmp_path):
    monkeypatch.setenv("ARAS_POLICY_WEIGHTS", str(tmp_path / "none.npz"))
    with pytest.raises(ConfigurationError, match="the policy is missing: .*learning.policy"):
        Policy()
    monkeypatch.undo()
    with pytest.raises(ExperimentError, match="needs images"):
        run(Experiment(plant="free", scheme=SCHEME))
