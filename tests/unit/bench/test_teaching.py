"""Training of the networks: images with labels, training, and programs."""

import functools
import re
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import gymnasium
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aras_visual_servo_base.poses import exponential, inverse, matrix_from_xyz_rpy
from aras_visual_servo_bench.cli.run import find_study_file
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.learning import learned_pose, policy
from aras_visual_servo_bench.learning import learned_scheme as learned
from aras_visual_servo_bench.learning.policy import PolicyNetwork
from aras_visual_servo_bench.learning.regressor import Regressor, fit_network, run_training
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.errors import ConfigurationError, MeasurementError
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.observation.observation import Observation


def test_moments_are_those_of_the_target_from_where_the_answer_says():
    x, y = learned.make_training_data(12, seed=3)
    parts = assemble(Experiment(plant="ideal", features="exact", goal="2016", start="2016"))
    np.testing.assert_allclose(np.hypot(y[:, 3], y[:, 4]), 1.0, atol=1e-6)
    for row, (*place, c, s) in zip(x, y, strict=True):
        c_T_g = matrix_from_xyz_rpy(place, (0.0, 0.0, np.arctan2(s, c)))
        seen_from = parts.target.target_T_camera(parts.goal_pose @ inverse(c_T_g))
        outline = parts.target.shape.outline(seen_from)
        exact = learned.make_inputs(Moments.from_polygon(outline, 3))
        np.testing.assert_allclose(row, exact, atol=2e-2)
        assert np.abs(row[:3] - exact[:3]).max() < 2e-3
    assert np.ptp(y[:, 2]) > 0.05 and np.ptp(np.arctan2(y[:, 4], y[:, 3])) > 1.0
    np.testing.assert_array_equal(learned.make_training_data(2, seed=3)[1], y[:2])
    assert (learned.make_training_data(2, seed=4)[1] != y[:2]).any()


def test_inputs_are_free_of_the_moments_units():
    corners = np.array([(0.1, 0.2), (0.5, 0.3), (0.2, 0.6)])
    one = learned.make_inputs(Moments.from_polygon(corners, 3))
    scaled = learned.make_inputs(Moments.from_polygon(3.0 * corners, 3))
    np.testing.assert_allclose(scaled[3:], one[3:], atol=1e-12)
    np.testing.assert_allclose(scaled[:3] - one[:3], [*(2 * corners.mean(axis=0)), np.log(3.0)])
    a, b, c = corners - corners.mean(axis=0)
    second = sum(np.outer(p, p) for p in (a, b, c)) / 12.0  # of a triangle, by its area
    area = 0.5 * abs(np.linalg.det([corners[1] - corners[0], corners[2] - corners[0]]))
    np.testing.assert_allclose(one[3:6] * area, [second[0, 0], second[0, 1], second[1, 1]])
    third = sum(np.einsum("i,j,k->ijk", p, p, p) for p in (a, b, c)) / 30.0
    np.testing.assert_allclose(one[6:] * area**1.5, [
        third[0, 0, 0], third[0, 0, 1], third[0, 1, 1], third[1, 1, 1]], rtol=1e-9)
    assert one[2] == pytest.approx(0.5 * np.log(area))


def test_pictures_of_the_poster_are_seen_from_where_the_answers_say():
    """What has more contrast than one grey level is brought to a deviation of 1."""
    fine = np.tile([0.0, 1.0], (21, 14))
    for step, deviation in ((1, 0.5), (2, 1.0), (40, 1.0)):
        grey = (100 + step * fine).astype(np.uint8)
        assert learned_pose.make_inputs(grey).std() == pytest.approx(deviation)
    x, y = learned_pose.make_training_data(6, seed=472)  # of the first textures
    assert x.shape == (6, 28 * 21) and y.shape == (6, 6)
    study = Study.from_yaml(find_study_file(Path("convergence_domain")))
    start = study.combinations[0].set["start"]
    parts = assemble(Experiment.from_mapping({
        **study.experiment, "scheme": "luminance", "start": start}))
    camera, poster = parts.calibrated_camera, parts.target.shape
    disturb = functools.cache(lambda k: poster.perturb(47_300_000 + k))
    for k, (row, motion) in enumerate(zip(x, y, strict=True)):
        t_T_c = parts.target.target_T_camera(parts.goal_pose @ exponential(motion))
        corners = (poster.vertices() - t_T_c[:3, 3]) @ t_T_c[:3, :3]
        u, v = camera.project(*(corners[:, :2] / corners[:, 2:]).T)
        rows, columns = poster.pixels.shape
        source = np.array([(0, 0), (columns, 0), (columns, rows), (0, rows)]) - 0.5
        H = cv2.getPerspectiveTransform(source.astype(np.float32),
                                        np.column_stack([u, v]).astype(np.float32))
        for one in map(disturb, range(learned_pose.TEXTURE_COUNT)) if k % 4 % 2 else [poster]:
            shown = cv2.warpPerspective(one.pixels, H, (camera.width, camera.height),
                                        flags=cv2.INTER_AREA, borderValue=255)
            small = cv2.resize(shown, (28, 21), interpolation=cv2.INTER_AREA).ravel()
            if np.corrcoef(small, row)[0, 1] > 0.995:
                break
        else:
            pytest.fail(f"image {k} is of no poster")
    far = np.linalg.norm(y[:, :3], axis=1)
    assert far[0] > 0.05 and far[4] > 0.05
    off_the_way = [np.linalg.norm(motion - y[0] * (motion @ y[0]) / (y[0] @ y[0]))
                   for motion in y[1:4]]
    assert max(off_the_way) < 0.15 and min(off_the_way) > 1e-3


class Flown:
    """Environments with given poses; `asked` lists the actions."""

    def __init__(self, count: int) -> None:
        random = np.random.default_rng(5)
        self.asked, self.closed, self.at = [], False, 0
        self.pictures = random.integers(0, 255, (40, count, 240, 320), np.uint8)
        turns = Rotation.from_rotvec(random.uniform(-1.0, 1.0, (40 * count, 1)) * [0, 0, 1])
        self.poses = np.tile(np.eye(4), (40, count, 1, 1))
        self.poses[..., :3, :3] = turns.as_matrix().reshape(40, count, 3, 3)
        self.poses[..., :3, 3] = random.uniform(-0.05, 0.05, (40, count, 3))

    def reset(self, seed):
        self.seed = seed
        return self.pictures[0], {"camera_T_goal": self.poses[0]}

    def step(self, action):
        self.asked.append(action)
        self.at += 1
        return self.pictures[self.at], None, None, None, {"camera_T_goal": self.poses[self.at]}

    def close(self):
        self.closed = True


def test_a_policy_is_told_where_the_goal_was_in_each_picture(monkeypatch):
    flown, given = Flown(3), []
    monkeypatch.setattr(gymnasium, "make_vec", lambda *a, **k: given.append((a, k)) or flown)
    x, y = policy.collect_demonstrations(None, 10, seed=4, environments=3)
    assert given == [((policy.ENVIRONMENT, 3, "async"),
                      {"experiment": policy.TRAINING_EXPERIMENT, "observes": "image"})]
    assert flown.seed == 4 and flown.closed and len(x) == len(y) == 12
    poses = flown.poses[:4].reshape(12, 4, 4)
    np.testing.assert_allclose(x, [policy.make_inputs(one)
                                   for one in flown.pictures[:4].reshape(12, 240, 320)])
    np.testing.assert_array_equal(y[:, :3], poses[:, :3, 3])
    turn = Rotation.from_matrix(poses[:, :3, :3]).as_euler("xyz")[:, 2]
    np.testing.assert_allclose(y[:, 3:], np.column_stack([np.cos(turn), np.sin(turn)]))


@pytest.mark.parametrize("flies", ["teacher", "policy"])
def test_the_camera_flies_to_the_goal_with_additions_that_last_for_some_steps(monkeypatch, flies):
    """Half of the time none is added: then an action is that towards the goal."""
    flown = Flown(6)
    flown.pictures = flown.pictures[:, :, :24, :32]
    monkeypatch.setattr(gymnasium, "make_vec", lambda *_, **__: flown)
    network = (lambda row: 0.1 * row[:4]) if flies == "policy" else None
    x, y = policy.collect_demonstrations(network, 6 * 39, seed=1, environments=6)
    asked = np.array(flown.asked)
    assert asked.dtype == np.float32 and abs(asked).max() <= 1.0
    goal = np.array([network(row) for row in x]) if network else np.column_stack(
        [y[:, :3], np.arctan2(y[:, 4], y[:, 3])])  # fmt: skip
    twist = np.zeros((len(x), 6))
    twist[:, [0, 1, 2, 5]] = 1.5 * goal
    wanted = np.clip(twist / [0.25, 0.25, 0.25, 1.5, 1.5, 1.5], -1.0, 1.0)
    exact = np.isclose(asked.reshape(-1, 6), wanted, atol=1e-6).all(axis=1).reshape(-1, 6)
    assert 0.25 < exact.mean() < 0.75 and 6 < (np.diff(exact, axis=0) != 0).sum() < 39 * 6 * 0.4


def test_the_policy_s_program_learns_by_what_it_has_met(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(gymnasium, "make_vec", lambda *_, **__: Flown(5))
    out = tmp_path / "a" / "mine.npz"
    given = ["--steps", "41", "--environments", "5", "--out", str(out)]
    assert policy.main(given) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4 and lines[3] == f"wrote {out}"
    for k, line in enumerate(lines[:3]):
        assert re.fullmatch(f"round {k + 2} of 4: median error on 10 new images before training: "
                            r"[\d.]+ mm, [\d.]+ degrees", line)  # fmt: skip
    assert PolicyNetwork.load(out)(np.zeros(40 * 30)).shape == (4,)
    monkeypatch.setitem(sys.modules, "sklearn.neural_network", None)
    assert policy.main(given) == 1
    assert capsys.readouterr().err.startswith("policy: training needs scikit-learn")


def test_a_program_says_how_well_its_network_knows_unseen_pictures(tmp_path, capsys):
    class Sums(Regressor):
        user, module = "sums", "sums"
        activation = staticmethod(lambda values: values)

        @classmethod
        def train(cls, x, y):
            if len(x) == 99:
                raise ExperimentError("no library")
            assert len(x) == len(y) == 7
            return {"mean": np.zeros(2), "scale": np.ones(2), "out_mean": np.zeros(1),
                    "out_scale": np.ones(1), "w0": np.ones((2, 1)), "b0": np.zeros(1)}

        def __call__(self, x):
            return self.predict(x)

    asked = []

    def make_images(count, seed=0):
        asked.append((count, seed))
        return np.arange(2.0 * count).reshape(count, 2), np.zeros((count, 1))

    out = tmp_path / "deep" / "sums.npz"
    for _ in range(2):  # the second time its folder is there
        asked.clear()
        assert run_training(
            Sums, ["--pictures", "7", "--out", str(out)], "text", 99, 5, make_images,
            lambda found, y: (found[:, 0], found[:, 0] / 100.0)) == 0  # fmt: skip
        assert asked == [(7, 0), (5, 1)] and sorted(np.load(out)) == [
            "b0", "mean", "out_mean", "out_scale", "scale", "w0"]
        assert capsys.readouterr().out == (  # sums of 1, 5, 9, 13, 17
            f"wrote {out}; median error on 5 test images: 9000.0 mm, 5.16 degrees\n")
    assert run_training(Sums, ["--out", str(out)], "text", 99, 5, make_images, None) == 1
    assert asked[-1] == (99, 0) and capsys.readouterr().err == "sums: no library\n"


def test_a_network_s_arrays_answer_as_scikit_learn_s_own(monkeypatch):
    from sklearn.neural_network import MLPRegressor
    random = np.random.default_rng(0)
    x = np.column_stack([random.normal(3.0, 2.0, 80), random.normal(-1.0, 0.5, 80), np.ones(80)])
    y = np.column_stack([x[:, 0] * x[:, 1], np.sin(x[:, 0])])
    options = {"hidden_layer_sizes": (9, 5), "activation": "tanh", "max_iter": 40,
               "random_state": 3, "learning_rate_init": 0.01}  # fmt: skip
    steps, fit = [], MLPRegressor.fit

    def watched(self, *given):
        steps.append((self.learning_rate_init, self.max_iter, self.warm_start))
        watched.network = self
        return fit(self, *given)

    monkeypatch.setattr(MLPRegressor, "fit", watched)
    arrays = fit_network(x, y, 0.25, np.float64, ((1e-3, 4), (1e-4, 2)), **options)
    assert steps == [(0.01, 40, False), (1e-3, 4, True), (1e-4, 2, True)]
    np.testing.assert_allclose(arrays["mean"], x.mean(axis=0))
    np.testing.assert_allclose(arrays["scale"], [x[:, 0].std(), x[:, 1].std(), 0.25])
    np.testing.assert_allclose(arrays["out_mean"], y.mean(axis=0))
    np.testing.assert_allclose(arrays["out_scale"], y.std(axis=0))

    class Tanh(Regressor):
        activation = np.tanh

    scaled = (x - arrays["mean"]) / arrays["scale"]
    own = watched.network.predict(scaled) * arrays["out_scale"] + arrays["out_mean"]
    found = np.array([Tanh(arrays).predict(row) for row in x])
    np.testing.assert_allclose(found, own, atol=1e-4)
    half = fit_network(x, y, 1e-6, np.float16, **options)
    assert half["w0"].dtype == np.float16 and half["b1"].dtype == np.float32
    assert half["scale"][2] == 1e-6 and len([name for name in half if name[0] in "wb"]) == 6


def test_how_far_off_answers_are_is_in_metres_and_radians():
    found = np.array([[0.1, 0.2, 0.3, 3.1], [0.0, 0.0, 0.0, 0.2]])
    y = np.array([[0.1, 0.2, 0.7, np.cos(-3.1), np.sin(-3.1)], [0.3, 0.4, 0.0, 1.0, 0.0]])
    far, turn = learned.compute_errors(found, y)
    np.testing.assert_allclose(far, [0.4, 0.5])
    np.testing.assert_allclose(turn, [2 * np.pi - 6.2, 0.2])
    far, turn = learned_pose.compute_errors(np.arange(12.0).reshape(2, 6), np.zeros((2, 6)))
    np.testing.assert_allclose(far, [np.sqrt(5.0), np.sqrt(36 + 49 + 64)])
    np.testing.assert_allclose(turn, [np.sqrt(50.0), np.sqrt(81 + 100 + 121)])


class Says(learned.GoalPoseNetwork):
    @classmethod
    def load(cls):
        return cls.made

    def __init__(self, told):
        self.told, self.asked = np.array(told), []

    def __call__(self, x):
        self.asked.append(x)
        return self.told.copy()


AT_GOAL, NOW = (0.01, 0.0, -0.02, -3.0), (0.1, -0.2, 0.3, 3.0)


@pytest.fixture(params=[learned.LearnedScheme, policy.Policy])
def flown(request, pinhole):
    network = Says(AT_GOAL)
    moments = Moments.from_polygon(np.array([(0.1, 0.2), (0.5, 0.3), (0.2, 0.6)]), 3)
    image = np.random.default_rng(0).integers(0, 255, (240, 320), np.uint8)
    scheme = type("", (request.param,), {"network": type("", (Says,), {"made": network})})()
    seen = Observation(0.0, 0.04, True, "", pinhole, moments=moments, image=image)
    goal = replace(Goal.teach(scheme, seen, depth=0.6), name="home")
    scheme.check(goal)
    network.told = np.array(NOW)
    is_policy = request.param is policy.Policy
    wanted = policy.make_inputs(image) if is_policy else learned.make_inputs(moments)
    return scheme, seen, goal, network, wanted


def test_the_camera_flies_to_where_the_network_has_the_goal_less_its_bias_there(flown):
    scheme, seen, goal, network, wanted = flown
    decision = scheme.compute(seen, goal, 0.5)
    np.testing.assert_allclose(network.asked[-1], wanted)
    off = np.array([0.09, -0.2, 0.32, 6.0 - 2 * np.pi])  # the angle the shorter way round
    np.testing.assert_allclose(decision.error, -off, atol=1e-12)
    assert decision.names == ("tx", "ty", "tz", "psi") and scheme.units == ("m", "m", "m", "rad")
    np.testing.assert_array_equal(decision.features, NOW)
    np.testing.assert_array_equal(decision.desired, AT_GOAL)
    gain = np.linalg.norm(decision.task.twist) / np.linalg.norm(off)
    assert gain > 0.1
    np.testing.assert_allclose(decision.task.twist, gain * off[[0, 1, 2, 3, 3, 3]]
                               * [1, 1, 1, 0, 0, 1], atol=1e-12)
    np.testing.assert_array_equal(decision.task.modelled, [1, 1, 1, 0, 0, 1])
    coarse = isinstance(scheme, policy.Policy)
    assert scheme.tolerances == ((0.0005,) * 3 + (0.002,) if coarse else (0.001,) * 3 + (0.005,))
    other = replace(goal, name="other")  # a goal that it was not told of
    network.told = np.array(AT_GOAL)
    if not coarse:
        assert not scheme.compute(seen, other, 0.6).error.any()


def test_what_is_not_seen_or_was_not_shown_is_said(flown):
    scheme, seen, goal, _, _ = flown
    for reason in ("dark", ""):
        with pytest.raises(MeasurementError, match=reason or "the target is not visible"):
            scheme.compute(replace(seen, valid=False, reason=reason), goal, 0.0)
    wrong = [(replace(goal, features={"policy": {"told": told}}), "home was not taught with the po")
             for told in ([0.0] * 3, [0.0, 0.0, 0.0, np.nan])]
    if not isinstance(scheme, policy.Policy):
        with pytest.raises(MeasurementError, match="not visible"):
            scheme.compute(replace(seen, moments=None), goal, 0.0)
        wrong = [(replace(goal, moments=None), "home contains no moments: teach it again")]
    for other, why in wrong:
        with pytest.raises(ConfigurationError, match=why):
            scheme.check(other)
