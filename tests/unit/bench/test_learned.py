"""Learned scheme: weights, message if they are missing, final pose."""

import numpy as np

from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.learning import learned
from aras_visual_servo_bench.learning.learned import TRAINING_STARTS
from aras_visual_servo_bench.runner.loop import run

SCHEME = "aras_visual_servo_bench.learning.learned:LearnedScheme"


def test_a_network_learns_what_is_linear(tmp_path):
    random = np.random.default_rng(0)
    x = random.normal(size=(60, 10))
    turn = 0.4 * x[:, 3]
    y = np.column_stack([0.1 * x[:, 0], x[:, 1] - x[:, 2], x[:, 2], np.cos(turn), np.sin(turn)])
    np.savez(tmp_path / "w.npz", **learned.train(x, y))
    network = learned.GoalPoseNetwork.load(tmp_path / "w.npz")
    found = np.array([network(row) for row in x[:20]])
    wanted = np.column_stack([y[:20, :3], turn[:20]])
    assert np.abs(found - wanted).max() < 0.1


def test_unseen_starts_converge():
    hits = 0
    for seed in range(500, 505):
        experiment = Experiment(
            plant="ideal", features="exact", goal="2016", start=TRAINING_STARTS, scheme=SCHEME,
            gain=2.0, duration=8.0, seed=seed, reached=(1e-3, 0.01),
            controller_parameters={"hold": 0.4},
        )  # fmt: skip
        hits += run(experiment).verdict.is_reached
    assert hits >= 4
