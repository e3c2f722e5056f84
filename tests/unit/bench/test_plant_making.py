"""From an experiment to its plant, without making one: what it is made of, and how goals are taught
before it."""

import dataclasses

import numpy as np
import pytest

from aras_sim_bridge.camera.config import derive_seed
from aras_sim_bridge.camera.effects import Effects
from aras_sim_bridge.camera.vibration import Vibration
from aras_visual_servo_base.memory import ByteLimitedCache
from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment import cameras
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.plants.imaging import capture
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_bench.setup.dynamic_arm_setup import (
    find_mounted_targets,
    take_first_images,
)
from aras_visual_servo_bench.setup.goal_teaching import needs_images, teach_goal
from aras_visual_servo_bench.setup.imaging_setup import make_imaging_settings
from aras_visual_servo_bench.setup.robot_camera_reader import read_context
from aras_visual_servo_bench.studies.study import Study
from aras_visual_servo_bench.targets.textures import TexturedTarget
from aras_visual_servo_controller.observation.frame import Frame
from aras_visual_servo_controller.observation.observation import Need

EYE = {"width": 320, "height": 240, "update_rate": 20.0,
       "camera_matrix": {"fx": 300.0, "fy": 280.0, "cx": 166.0, "cy": 115.0}}  # fmt: skip
FLAT = {"shape": "l_shape", "size": [0.08, 0.06], "pose": [0.0, 0.0, 0.591, 0.0, 0.0, 0.3]}
ABOVE = matrix_from_xyz_rpy((0.01, 0.02, 0.85), (np.pi - 0.1, 0.05, 0.2))
MOMENTS = frozenset({Need.MOMENTS})


def context_of(needs=None, depth=False, label="", **keys):
    """Return the RunSetup of an experiment; `needs` by the names of its cameras."""
    read = read_context(Experiment.from_mapping({"camera": EYE, "target": FLAT, **keys}))
    needs = needs or {read.control_camera.name: MOMENTS}
    return dataclasses.replace(read, needs=needs, has_depth=depth, labelled_link=label)


def seen(context, exactly=False):
    return make_imaging_settings(context, context.control_camera, exactly)


FREE = {"plant": "free"}
DRAWN = {**FREE, "features": "images"}


def test_a_sight_has_what_is_needed_and_asked_for():
    for needs, asked, wanted in ((MOMENTS, False, False), (MOMENTS, True, True),
                                 (frozenset({Need.DEPTH}), False, True)):  # fmt: skip
        assert seen(context_of({"camera": needs}, depth=asked, **FREE)).has_depth is wanted
    for needs, label, wanted in ((MOMENTS, "m", True), (MOMENTS, "", False),
                                 (frozenset({Need.IMAGE}), "m", False)):  # fmt: skip
        assert seen(context_of({"camera": needs}, label=label, **FREE)).has_labels is wanted
    found = seen(context_of(**FREE, jitter=0.3))
    assert (found.rate, found.name, found.jitter, found.effects) == (20.0, "camera", 0.3, Effects())
    assert (found.placement, len(found.row_bands), found.vibration, found.is_unbounded) == (
        None, 1, None, False)
    assert not found.has_images and found.camera.K[0] == 300.0 and found.occluder is None
    for unbounded in (True, False):
        ideal = context_of(plant="ideal", ideal={"unbounded": unbounded})
        assert seen(ideal).is_unbounded is unbounded


def test_a_goal_is_taught_without_noise():
    effects = {"row_time": 1e-4, "rows_together": 40, "exposure_time": 0.002,
               "drop_probability": 0.2, "sensor": {
                   "gain": 0.02, "full_well": 12e3, "dark_current": 50.0}}
    eye = {**EYE, "effects": effects, "shake": {"xyz": [1e-3, 0, 0], "frequency": 20.0}}
    pictured = {**DRAWN, "noise": 2.0}
    made = context_of(**{**pictured, "camera": eye})
    run, taught = seen(made), seen(made, exactly=True)
    assert run.effects == dataclasses.replace(
        cameras.make_camera_config(eye).effects, noise_stddev=2.0) and run.has_images
    assert taught.effects == Effects(rows_together=40) and taught.has_images
    assert run.vibration is not None and taught.vibration is None and len(taught.row_bands) == 1
    quiet = seen(context_of(**DRAWN, camera=eye), exactly=True)  # also without noise of its own
    assert (quiet.effects, quiet.vibration) == (taught.effects, None)
    noisy = [
        capture(seen(context_of(**{**pictured, "camera": eye}, seed=seed)), ABOVE, 10**8,
                np.random.default_rng(0)).image
        for seed in (1, 1, 2)]
    np.testing.assert_array_equal(*noisy[:2])
    assert (noisy[0] != noisy[2]).any() and noisy[0].shape == (240, 320)
    # Forty rows at once, each at the middle of its own.
    opened = [p for p in run.row_bands if p.first == 0]
    assert {(p.first, p.last) for p in run.row_bands} == {(k, k + 40) for k in range(0, 240, 40)}
    assert opened[2].offset_ns == round(1e9 * 1e-4 * (19.5 - 119.5)) and len(opened) == 5
    exact = context_of(**{**FREE, "jitter": 0.4})
    assert (seen(exact).jitter, seen(exact, True).jitter) == (0.4, 0.0)
    # A rendered goal is drawn only where the whole image counts.
    for needs, drawn in ((MOMENTS, False), (frozenset({Need.IMAGE}), True)):
        assert seen(context_of({"camera": needs}), exactly=True).has_images is drawn
    assert seen(context_of()).has_images


def test_noise_is_each_camera_s_and_each_seed_s():
    eye = {**EYE, "shake": {"xyz": [1e-3, 0, 0], "frequency": 20.0}}
    for seed, own, derived in ((1, {}, derive_seed(1, "camera")), (1, {"seed": 77}, 77),
                               (2, {}, derive_seed(2, "camera"))):  # fmt: skip
        vibration = seen(context_of(**FREE, seed=seed, camera={**eye, **own})).vibration
        other = Vibration(cameras.make_camera_config(eye).shake, derived)
        np.testing.assert_array_equal(vibration.compute_pose(10**9), other.compute_pose(10**9))


def test_what_covers_a_target_is_not_there_when_the_goal_is_taught():
    cover = ((-0.01, -0.02), (0.03, 0.04))
    for times in (None, [[1.0, 2.0]]):
        made = context_of(**DRAWN, target={**FLAT, "occluder": cover, "occluded": times})
        kept = None if times is None else ((1.0, 2.0),)
        assert (seen(made).occluder, seen(made).occlusion_times) == (cover, kept)
        assert seen(made, True).occlusion_times == (None if times is None else ())
    poster = {"shape": "poster", "size": [0.02, 0.01], "pose": FLAT["pose"], "perturbed": True}
    made = context_of(**DRAWN, target=poster, seed=3)
    assert seen(made, True).target is made.target
    other = seen(made).target
    np.testing.assert_array_equal(other.shape.pixels, made.target.shape.perturb(3).pixels)
    assert isinstance(other.shape, TexturedTarget) and other.pose is made.target.pose
    with pytest.raises(ExperimentError, match="target 'l_shape' has no texture that could be pert"):
        seen(context_of(**DRAWN, target={**FLAT, "perturbed": True}))


OWN = {"shape": "square", "size": [0.05, 0.05], "pose": [0.3, 0.0, 0.6, 0.0, 0.0, 0.1]}
TWO = {"left": {"model": EYE}, "right": {"model": EYE, "xyz": [0.0, -0.1, 0.0], "target": OWN}}


def test_a_camera_may_look_at_a_target_of_its_own():
    cover = {"occluder": ((-0.01, -0.02), (0.03, 0.04))}
    made = context_of({"left": MOMENTS}, **DRAWN, camera="original", cameras=TWO,
                 target={**FLAT, **cover})
    assert [name for name in made.cameras if made.has_own_target(name)] == ["right"]
    assert made.find_target_spec("right").shape == "square"
    assert made.find_target_spec("left").shape == "l_shape"
    np.testing.assert_allclose(
        made.targets["right"].pose, matrix_from_xyz_rpy(OWN["pose"][:3], OWN["pose"][3:]))
    assert made.targets["left"] is made.target
    left, right = (make_imaging_settings(made, eye) for eye in made.cameras.values())
    assert (left.name, right.name) == ("left", "right")
    assert left.occluder is not None and right.occluder is None
    assert right.target.shape is made.targets["right"].shape
    np.testing.assert_allclose(right.placement.pose[:3, 3], [0.1, 0.0, 0.0], atol=1e-12)


START = np.array([0.05, 0.0, -0.09, 0.045, 0.045, 0.1])


def test_targets_that_the_arm_carries_are_put_onto_its_links():
    frame = {"target_frame": "hand"}
    given = {"plant": "bullet", "target": FLAT, "robot": frame}
    found = find_mounted_targets(Experiment.from_mapping(given))
    assert list(found) == ["target"] and found["target"].link == "hand"
    np.testing.assert_allclose(
        found["target"].pose, matrix_from_xyz_rpy(FLAT["pose"][:3], FLAT["pose"][3:]))
    assert found["target"].urdf.suffix == ".urdf"
    eyes = {"a": {}, "b": {"target": OWN, "target_frame": "wrist"}, "c": {"target": OWN}}
    found = find_mounted_targets(Experiment.from_mapping({**given, "cameras": eyes}))
    assert {name: one.link for name, one in found.items()} == {
        "target": "hand", "target_of_b": "wrist", "target_of_c": "hand"}
    for changed in ({"plant": "chain"}, {"robot": {}}, {"target": {"shape": "aras"}},
                    {"target": {"shape": ((0, 0), (1, 0), (0, 1))}}):
        assert find_mounted_targets(Experiment.from_mapping({**given, **changed})) == {}


def test_a_goal_is_shown_by_the_first_picture_of_each_camera_that_is_read():
    """By images without noise and without what covers the target later."""
    eyes, found = {**TWO, "other": {"model": EYE}}, []
    for more in ({}, {"noise": 20.0, "seed": 5, "target": {
            **FLAT, "occluder": ((-0.1, -0.1), (0.1, 0.1)), "occluded": [[0.0, 9.0]]}}):
        made = context_of({"left": MOMENTS, "right": MOMENTS}, cameras=eyes, camera="original",
                          **more)  # fmt: skip
        found.append(take_first_images(made, START))
    for images in found:
        assert list(images) == ["left", "right"] and images["left"].image.shape[:2] == (240, 320)
        np.testing.assert_array_equal(images["left"].image, found[0]["left"].image)
    assert found[0]["left"].image.min() < 60  # of the target
    slow = {**TWO, "right": {"model": {**EYE, "update_rate": 0.5}}}
    made = context_of({"left": MOMENTS, "right": MOMENTS}, cameras=slow, camera="original")
    with pytest.raises(ExperimentError, match="delivers no image within 1 s, so the goal"):
        take_first_images(made, START)


def views(needs, **keys):
    return context_of({"camera": needs}, **{"scheme": "moments", **keys})


JOINTS = {"a": 0.1, "b": 0.2}


def taught(context, mounting=None, shift=(0.0, 0.0), size=1.0, image=True):
    """The goal by an image in which the target is off its place, px, or larger; or by none."""
    eye, target, images = context.control_camera, context.target, {}
    if image:
        outline = target.shape.outline(target.target_T_camera(ABOVE))
        middle = outline.mean(axis=0)
        off = np.array(shift) / [300.0, 280.0]
        drawn = cameras.draw_outline(middle + size * (outline - middle) + off, eye.true_camera)
        images = {"camera": Frame(0, drawn, "mono8", target_mask=255 - drawn)}
    mounting = np.eye(4) if mounting is None else mounting
    return teach_goal(context, ABOVE, {"camera": mounting}, {}, images, "home", JOINTS)


def test_a_goal_holds_what_is_seen_there_as_it_is_believed():
    off = matrix_from_xyz_rpy((0.01, -0.02, 0.0), (0.0, 0.05, 0.1))
    found = views(MOMENTS, plant="chain", features="exact")
    goal = taught(found, off, image=False)
    assert (goal.name, goal.joints) == ("home", JOINTS)
    np.testing.assert_allclose(goal.world_T_camera, ABOVE @ off, atol=1e-12)
    target = found.target
    at = target.target_T_camera(ABOVE @ off)
    assert goal.depth == pytest.approx(target.shape.depth(at))
    np.testing.assert_allclose(goal.plane, target.shape.plane(at), atol=1e-12)
    x, y = target.shape.outline(target.target_T_camera(ABOVE)).T
    area = 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    assert goal.moments.m00 == pytest.approx(area)


CORNERS = frozenset({Need.CORNERS})
BENT = {"shape": ((-0.05, -0.04), (0.05, -0.04), (0.05, 0.04), (-0.05, 0.0))}


@pytest.mark.parametrize(("needs", "keys", "shown"), [
    (MOMENTS, {}, False), (CORNERS, {"scheme": "points"}, True),
    (CORNERS, {"scheme": "points", "features": "exact"}, False),
    (CORNERS, {"scheme": "points", "plant": "free"}, False), (MOMENTS, {"label": "target"}, True),
    (MOMENTS, {"target": {"shape": "box", "size": [0.06, 0.05, 0.03], "pose": FLAT["pose"]}}, True),
])  # fmt: skip
def test_what_a_picture_teaches_is_taught_by_one(needs, keys, shown):
    assert needs_images(views(needs, **keys)) is shown


@pytest.mark.parametrize(("keys", "shift", "size", "why"), [
    *(({"label": "target"}, shift, 1.0, "") for shift in ((9.0, 0.0), (-9.0, 9.0))),
    *(({"label": "target"}, shift, 1.0, "another object is detected")
      for shift in ((60.0, 0.0), (-60.0, 0.0), (0.0, 60.0), (0.0, -60.0))),
    # A described target has the size of its corners: 8 % of the area; another one any.
    *(({"target": BENT}, (0.0, 0.0), size, "") for size in (1.04, 0.96)),
    *(({"target": BENT}, (0.0, 0.0), size, f"area in the image is {told} times the area")
      for size, told in ((1.06, "1.12"), (0.94, "0.88"))),
    ({"target": BENT, "calibration_offset": {"focal": 0.8}}, (0.0, 0.0), 1.0, ""),
    ({"label": "target"}, (0.0, 0.0), 1.06, "")])  # fmt: skip
def test_something_else_of_the_target_s_colour_is_told(keys, shift, size, why):
    found = views(MOMENTS, **keys)
    if not why:
        taught(found, shift=shift, size=size)
        return
    with pytest.raises(ExperimentError, match=why):
        taught(found, shift=shift, size=size)


def test_runs_of_a_study_share_the_images_of_their_goals():
    """A goal is rendered again only for a run whose goal looks different."""
    study = Study.from_mapping({
        "experiment": {"plant": "bullet", "scheme": "points", "noise": 3.0, "target": FLAT,
                       "start": {"height": [0.15, 0.4]}},
        "cases": [{}, {"gain": 2.0}, {"target.size": [0.06, 0.05]}]})  # fmt: skip
    sizes = []
    images = ByteLimitedCache(10**8, lambda frames: sizes.append(len(frames)) or 1)
    for run, count in enumerate((1, 1, 3)):  # the size of both is computed to add the second
        parts = assemble(study.make_experiment(run), goal_images=images)
        alone = assemble(study.make_experiment(run))
        for made in (parts, alone):
            made.plant.close()
        assert parts.goal.features == alone.goal.features
        np.testing.assert_array_equal(parts.plant.read_joints()[0], alone.plant.read_joints()[0])
        assert len(sizes) == count
