"""Short selection of the shipped studies."""

from pathlib import Path

import numpy as np
import pytest

from aras_visual_servo_bench.cli.run import find_study_file
from aras_visual_servo_bench.metrics import decay, metrics
from aras_visual_servo_bench.recording.run import Run
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.studies.study import Study


def shipped(name):
    return Study.from_yaml(find_study_file(Path(name)))


def fitted(stamp: np.ndarray, error: np.ndarray) -> float:
    """Decay (1/s) of an error (n,) between 80 and 15 % of its first value."""
    part = np.abs(error) / abs(error[0])
    begin, end = int(np.argmax(part < 0.80)), int(np.argmax(part < 0.15)) or len(part)
    return float(-np.polyfit(stamp[begin:end], np.log(part[begin:end]), 1)[0])


def test_features_decay_as_gain_and_delay_predict():
    study = shipped("decay")
    gain = 2.0
    (point,) = (p for p in range(study.point_count) if study.make_settings(p)["gain"] == gain)
    result: Run = run(study.make_experiment(point))
    rate = metrics.find_metric("decay_predicted").measure(result)
    assert rate > gain
    assert metrics.find_metric("decay_rate").measure(result) == pytest.approx(rate, rel=0.05)
    for i, name in enumerate(result.names):
        assert fitted(result.stamp, result.error[:, i]) == pytest.approx(rate, rel=0.05), name


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
    assert fitted(t, s) == pytest.approx(decay.predict_decay_rate(gain, tau), rel=0.02)
    assert decay.predict_decay_rate(gain, 0.0) == pytest.approx(-np.log(1 - gain * period) / period)
    # With a gain that goes beyond the goal by half of the way each time.
    assert decay.predict_decay_rate(1.5 / period, 0.0) == pytest.approx(np.log(2.0) / period)


def test_loop_and_physics_agree_from_any_start():
    result = run(shipped("starts").make_experiment(1).with_changes(plant="chain"))
    assert metrics.find_metric("contradicts").measure(result) == 0.0, result.outcome
    assert result.verdict.is_reached


@pytest.mark.parametrize(
    "failure", ["target_lost", "out_of_reach", "wrong_object", "local_minimum"]
)
def test_a_provoked_failure_is_named(failure):
    study = shipped("failures")
    names = [case.names["failure"] for case in study.combinations]
    assert len(names) == 12
    assert all(case.published == {"outcome": case.names["failure"]} for case in study.combinations)
    result = run(study.make_experiment(study.repeats * names.index(failure) + 1))
    assert result.outcome == failure, result.reason
