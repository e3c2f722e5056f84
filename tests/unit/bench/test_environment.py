"""Gymnasium environment: it passes Gymnasium's checker, and executes the commanded twists."""

import contextlib
import warnings
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from frames import take_frames
from gymnasium.utils.env_checker import check_env

from aras_visual_servo_base.poses import pose_difference
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment, RandomStart
from aras_visual_servo_bench.runner.environment import (
    ENVIRONMENT,
    MAX_TWIST,
    ExternalTwistScheme,
    ServoEnv,
)
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_controller.schemes import create_scheme


@pytest.fixture
def env():
    with contextlib.closing(ServoEnv()) as env:
        yield env


def test_a_twist_is_done_as_asked_and_what_is_none_is_refused(env):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # unbounded observations are meant
        check_env(env, skip_render_check=True)
    env.reset(seed=1)
    before, began = env.loop.plant.read_pose(), env.loop.plant.time_ns
    for _ in range(10):
        env.step(np.array([0.0, 0.0, 0.2, 0.0, 0.0, 0.0]))
    seconds = (env.loop.plant.time_ns - began) * 1e-9
    moved = before[:3, :3].T @ (env.loop.plant.read_pose()[:3, 3] - before[:3, 3])
    np.testing.assert_allclose(moved, [0.0, 0.0, 0.2 * 0.25 * seconds], atol=2.5e-3)
    for action in (np.zeros(5), np.full(6, np.nan)):
        with pytest.raises(ExperimentError, match="six finite numbers"):
            env.step(action)


def test_an_agent_that_does_as_the_law_does_gets_there():
    env = ServoEnv(Experiment(plant="free", lag=0.0, delay=0.0, start=RandomStart(turn=1.0)))
    env.reset(seed=4)
    for _ in range(400):
        output, action = env.loop.state.scheme_output, np.zeros(6)
        twist = np.linalg.pinv(output.L[:, [0, 1, 2, 5]]) @ (-2.0 * output.error)
        action[[0, 1, 2, 5]] = twist / np.array(MAX_TWIST)[[0, 1, 2, 5]]
        _, reward, ended, cut, info = env.step(np.clip(action, -1.0, 1.0))
        if ended or cut:
            break
    assert ended and (info["verdict"], info["outcome"]) == ("goal_reached", "converged"), info
    assert reward == pytest.approx(1.0, abs=0.05)


def test_an_episode_ends_when_the_target_is_lost_and_when_time_is_over(env):
    env.reset(seed=1)
    ended = False
    while not ended:
        _, _, ended, cut, info = env.step(np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
        assert not cut
    assert info["outcome"] == "target_lost"
    short = ServoEnv(Experiment(plant="free", lag=0.0, delay=0.0, duration=0.2))
    short.reset(seed=0)
    assert any(short.step(np.zeros(6))[3] for _ in range(15))


PICTURED = Experiment(plant="free", features="images", lag=0.0, delay=0.0, start=RandomStart())


def test_a_picture_and_where_the_goal_is_belong_together():
    env = ServoEnv(PICTURED, observes="image")
    picture, info = env.reset(seed=3)
    for _ in range(8):
        picture, _, _, _, info = env.step(np.array([0.2, -0.1, 0.1, 0.0, 0.0, 0.3]))
    assert picture.shape == (240, 320) and picture.dtype == np.uint8
    np.testing.assert_array_equal(env.render()[..., 1], picture)
    parts = env.loop.parts
    goal_T_camera = np.linalg.inv(info["camera_T_goal"])
    goal_T_target = parts.target.target_T_camera(parts.goal_pose @ goal_T_camera)
    outline = parts.target.shape.outline(goal_T_target)
    u, v = parts.cameras["camera"].true_camera.project(*outline.T)
    rows, columns = np.nonzero(picture < 128)
    assert columns.min() == pytest.approx(u.min(), abs=1.2)
    assert rows.max() == pytest.approx(v.max(), abs=1.2)
    assert info["distance"] == pytest.approx(np.linalg.norm(goal_T_camera[:3, 3]))
    env.close()


def test_many_are_stepped_at_once():
    made = gymnasium.make_vec(ENVIRONMENT, 3, "sync", experiment=PICTURED, observes="image")
    pictures, info = made.reset(seed=5)
    alone = [ServoEnv(PICTURED, observes="image") for _ in range(3)]
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


EXACT = Experiment.from_mapping({
    "plant": "free", "lag": 0.0, "delay": 0.0, "scheme": "pose", "features": "exact",
    "target": {"shape": "l_shape", "size": [0.06, 0.05], "pose": [0, 0, 0.59, 0, 0, 0]},
    "goal": {"pose": [0.0, 0.0, 0.85, np.pi, 0.0, 0.0]}, "start": {"height": [0.25, 0.4]},
})  # fmt: skip


def test_a_seed_is_drawn_from_the_environment_s_own_and_a_reward_is_in_units_of_the_first_error():
    env = ServoEnv(EXACT)
    for seed in (7, 8):
        seen, info = env.reset(seed=seed)
        drawn = int(np.random.default_rng(seed).integers(2**31))
        parts = assemble(EXACT.with_changes(seed=drawn))
        np.testing.assert_allclose(seen[-6:], parts.plant.read_joints()[0], atol=1e-12)
        pose = parts.plant.read_pose()
        np.testing.assert_allclose(info["camera_T_goal"], np.linalg.inv(pose) @ parts.goal_pose,
                                   atol=1e-12)  # fmt: skip
        assert (info["distance"], info["angle"]) == pytest.approx(
            pose_difference(parts.goal_pose, pose))  # fmt: skip
        assert (info["outcome"], info["reason"], info["verdict"]) == ("running", "", "goal_missed")
    first, rewards = np.linalg.norm(seen[:6]), []
    for action in (0.0, 1.0, 1.0, 1.0):
        seen, reward, ended, cut, _ = env.step(np.full(6, action) * [0, 0, 1, 0, 0, 0])
        assert reward == pytest.approx(-np.linalg.norm(seen[:6]) / first)
        assert not ended and not cut
        rewards.append(reward)
    assert rewards[0] == pytest.approx(-1.0) and abs(rewards[-1] + 1.0) > 1e-4
    env.close()
    env.close()


@pytest.mark.parametrize("keys", [{}, {"max_twist": (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)}])
def test_an_action_is_the_twist_in_parts_of_the_greatest(keys):
    env = ServoEnv(EXACT, **keys)
    greatest = np.array(keys.get("max_twist", MAX_TWIST))
    for action in ((0.5, -0.25, 0.1, -0.2, 0.3, -1.0), (9.0,) * 6, (-9.0,) * 6):
        env.reset(seed=3)
        env.step(np.array(action))
        task = env.loop.state.scheme_output.task
        np.testing.assert_allclose(task.twist, np.clip(action, -1, 1) * greatest, atol=1e-12)
    env.close()


@pytest.mark.parametrize("name", ["moments", "points"])
def test_a_scheme_whose_twist_is_asked_for_is_the_inner_one_in_all_else(name):
    parts = assemble(EXACT.with_changes(scheme=name))
    (frame,) = take_frames(parts.plant)
    arm, joints = parts.servo.arm, parts.plant.read_joints()[0]
    observation = parts.observe(frame, arm.read_joints(parts.plant.joint_names, joints))
    inner = create_scheme(name)
    asked = ExternalTwistScheme(inner)
    asked.check(parts.goal)  # the names of points depend on the goal
    for key in ("names", "tolerances", "needs", "cameras", "law"):
        assert getattr(asked, key) == getattr(inner, key), key
    assert asked.get_needs("camera") == inner.get_needs("camera")
    assert repr(asked.teach(observation)) == repr(inner.teach(observation))
    asked.twist = np.arange(1.0, 7.0)
    found, own = (one.compute(observation, parts.goal, 0.1) for one in (asked, inner))
    np.testing.assert_array_equal(found.error, own.error)
    np.testing.assert_array_equal(found.task.twist, asked.twist * own.task.modelled)
    np.testing.assert_array_equal(found.task.modelled, own.task.modelled)
    asked.reset()
    assert not asked.twist.any()


@pytest.mark.parametrize(("given", "why"), [
    ({"experiment": EXACT.with_changes(scheme="second_order:SecondOrder")},
     "SecondOrder' commands joints: an environment"),
    ({"max_twist": (1.0, 1.0, 0.0, 1.0, 1.0, 1.0)}, "six numbers above 0, m/s and rad/s"),
    ({"max_twist": (1.0,) * 5}, "six numbers above 0"),
    ({"observes": "picture"}, "use one of features, image"),
    ({"observes": "image"}, "set features to images"),
])  # fmt: skip
def test_what_makes_no_environment_is_refused(given, why, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parents[3] / "docs" / "examples")
    with pytest.raises(ExperimentError, match=why):
        ServoEnv(**given)
