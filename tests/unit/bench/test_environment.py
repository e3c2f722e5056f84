"""The Gymnasium environment: passes Gymnasium's own checker, and does what it is asked."""

import warnings

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from aras_visual_servo_bench.asked.experiment import Experiment, Sampler
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.running.environment import ServoEnv


@pytest.fixture
def env():
    env = ServoEnv()
    yield env
    env.close()


def test_gymnasiums_checker_finds_nothing(env):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # unbounded observations are meant
        check_env(env, skip_render_check=True)


def test_a_seed_draws_the_start(env):
    first, _ = env.reset(seed=1)
    other, _ = env.reset(seed=2)
    again, info = env.reset(seed=1)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert info["verdict"] == "goal_missed" and info["distance"] > 0.01


def test_a_twist_is_done_as_asked(env):
    env.reset(seed=1)
    before = env._loop.plant.pose()
    began = env._loop.plant.time_ns
    for _ in range(10):
        env.step(np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0]))
    after = env._loop.plant.pose()
    seconds = (env._loop.plant.time_ns - began) * 1e-9
    moved = before[:3, :3].T @ (after[:3, 3] - before[:3, 3])
    np.testing.assert_allclose(moved, [0.0, 0.0, 0.2 * 0.25 * seconds], atol=2.5e-3)


def test_an_agent_that_does_as_the_law_does_gets_there():
    env = ServoEnv(Experiment(plant="free", lag=0.0, delay=0.0, start=Sampler(turn=1.0)))
    env.reset(seed=4)
    total, ended = 0.0, False
    for _ in range(400):
        L = env._loop.state.decision.L
        twist = np.linalg.pinv(L[:, [0, 1, 2, 5]]) @ (-2.0 * env._error)
        action = np.zeros(6)
        action[[0, 1, 2, 5]] = twist / env._greatest[[0, 1, 2, 5]]
        _, reward, ended, cut, info = env.step(np.clip(action, -1.0, 1.0))
        total += reward
        if ended or cut:
            break
    assert ended and info["verdict"] == "goal_reached", info
    assert info["outcome"] == "converged"
    assert reward == pytest.approx(1.0, abs=0.05)


def test_an_episode_ends_when_the_target_is_lost_and_when_time_is_over(env):
    env.reset(seed=1)
    for _ in range(200):
        _, _, ended, _, info = env.step(np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
        if ended:
            break
    assert ended and info["outcome"] == "target_lost"
    short = ServoEnv(Experiment(plant="free", lag=0.0, delay=0.0, duration=0.2))
    short.reset(seed=0)
    assert any(short.step(np.zeros(6))[3] for _ in range(15))


def test_what_is_no_action_or_no_environment_is_refused(env):
    env.reset(seed=0)
    for action in (np.zeros(5), np.full(6, np.nan)):
        with pytest.raises(ExperimentError, match="six finite numbers"):
            env.step(action)
    with pytest.raises(ExperimentError, match="six numbers above 0"):
        ServoEnv(greatest=(1.0,) * 5)


def test_pictures_can_be_looked_at():
    env = ServoEnv(Experiment(plant="free", features="pictures"), render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == (240, 320, 3)
    assert ServoEnv().render() is None
