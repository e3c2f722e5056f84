"""A short choice of what the bench's studies show in full."""

from types import SimpleNamespace

import numpy as np
import pytest

from aras_visual_servo_bench.studies import decay, failures, starts


@pytest.mark.parametrize("gain", [1.0, 2.0])
def test_features_decay_as_gain_and_delay_predict(gain):
    result, rate = decay.decays(gain)
    for i, name in enumerate(result.names):
        found = decay.fitted(result.stamp, result.error[:, i])
        assert found == pytest.approx(rate, rel=0.05), name


def test_the_prediction_is_that_of_a_simulated_delay():
    gain, tau, period, step = 2.0, 0.045, 1.0 / 30.0, 1e-4
    s, history, commands = 1.0, [], []
    image = 0
    for k in range(30000):
        t = k * step
        if t >= image * period - 1e-12:
            commands.append((t + tau, -gain * s))
            image += 1
        speed = next((v for due, v in reversed(commands[-6:]) if due <= t + 1e-12), 0.0)
        s += speed * step
        history.append((t, s))
    t, s = np.array(history).T
    assert decay.fitted(t, s) == pytest.approx(decay.predicted(gain, tau), rel=0.02)
    assert decay.predicted(gain, 0.0) == pytest.approx(-np.log(1 - gain * period) / period)


@pytest.mark.parametrize("seed", range(4))
def test_loop_and_physics_agree_from_any_start(seed):
    (line,) = starts.study(
        starts.Experiment(plant="chain", start=starts.SAMPLER, duration=15.0), range(seed, seed + 1)
    )
    assert not line["contradicts"], line
    assert line["verdict"] == "goal_reached"


@pytest.mark.parametrize(
    ("outcome", "reached", "contradicts"),
    [
        ("converged", True, False), ("converged", False, True), ("target_lost", False, False),
        ("timed_out", True, True), ("converged up to 90°", False, False),
        ("converged up to 0.4 mm", True, False),
    ],
)  # fmt: skip
def test_what_contradicts_what(outcome, reached, contradicts):
    result = SimpleNamespace(
        outcome=outcome, converged=outcome.startswith("converged"),
        verdict=SimpleNamespace(reached=reached),
    )  # fmt: skip
    assert starts.contradicts(result) == contradicts


@pytest.mark.parametrize(
    "failure",
    ["target_lost", "singular", "out_of_reach", "saturation", "gain_too_high", "wrong_object",
     "scheme_fault", "timed_out", "local_minimum"],
)  # fmt: skip
def test_a_provoked_failure_is_named(failure):
    outcome, reason = failures.provoke(failure, seed=1)
    assert outcome == failure, reason
