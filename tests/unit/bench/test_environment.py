"""The Gymnasium environment: passes Gymnasium's own checker, and does what it is asked."""

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from aras_visual_servo_bench.asked.experiment import Experiment, Sampler
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.running.environment import ENVIRONMENT, ServoEnv


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


PICTURED = Experiment(plant="free", features="pictures", lag=0.0, delay=0.0, start=Sampler())


def test_a_picture_and_where_the_goal_is_belong_together():
    """The target, by the goal's true place, is where the picture has it."""
    env = ServoEnv(PICTURED, observes="picture")
    picture, info = env.reset(seed=3)
    for _ in range(8):
        picture, _, _, _, info = env.step(np.array([0.2, -0.1, 0.1, 0.0, 0.0, 0.3]))
    assert picture.shape == (240, 320) and picture.dtype == np.uint8
    assert env.observation_space.contains(picture)
    np.testing.assert_array_equal(env.render()[..., 1], picture)
    parts = env._loop.parts
    goal_T_camera = np.linalg.inv(info["camera_T_goal"])
    outline = parts.target.shape.outline(parts.target.seen_from(parts.goal_pose @ goal_T_camera))
    u, v = parts.eyes["camera"].true.project(*outline.T)
    dark = picture < 128
    rows, columns = np.nonzero(dark)
    assert columns.min() == pytest.approx(u.min(), abs=1.2)
    assert rows.max() == pytest.approx(v.max(), abs=1.2)
    assert info["distance"] == pytest.approx(np.linalg.norm(goal_T_camera[:3, 3]))
    env.close()


def test_many_are_stepped_at_once():
    made = gymnasium.make_vec(ENVIRONMENT, 3, "sync", experiment=PICTURED, observes="picture")
    pictures, info = made.reset(seed=5)
    alone = [ServoEnv(PICTURED, observes="picture") for _ in range(3)]
    actions = np.array([[0.3, 0, 0, 0, 0, 0], [0, 0.3, 0, 0, 0, 0], [0, 0, -0.3, 0, 0, 0.2]],
                       np.float32)  # fmt: skip
    first = [one.reset(seed=5 + i)[0] for i, one in enumerate(alone)]
    np.testing.assert_array_equal(pictures, first)
    for _ in range(4):
        pictures, rewards, *_, info = made.step(actions)
        each = [one.step(action) for one, action in zip(alone, actions, strict=True)]
    np.testing.assert_array_equal(pictures, [one[0] for one in each])
    np.testing.assert_array_equal(rewards, [one[1] for one in each])
    assert info["camera_T_goal"].shape == (3, 4, 4)
    for one in (made, *alone):
        one.close()


@pytest.mark.parametrize(("options", "complaint"), [
    ({"observes": "pictures"}, "did you mean 'picture'"),
    ({"observes": "picture"}, "features: pictures"),
])  # fmt: skip
def test_what_cannot_be_observed_is_refused(options, complaint):
    with pytest.raises(ExperimentError, match=complaint):
        ServoEnv(**options)
