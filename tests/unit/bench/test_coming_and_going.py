"""Occluders and lights that are present only at given times."""

from dataclasses import replace

import numpy as np
import pytest

from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment, SunSpec, TargetSpec
from aras_visual_servo_bench.runner.loop import Loop
from aras_visual_servo_bench.setup.assembly import assemble
from aras_visual_servo_controller.observation.feature_extractor import FeatureExtractor

TIMES = ((0.1, 0.2), (0.3, 0.4))  # at each an image is exposed, which is before a coming
OCCLUDER = ((0.01, -0.01), (0.06, 0.05))


def experiment(plant, **target):
    return Experiment(
        plant=plant, features="images", duration=0.42, time_after_convergence=None,
        scheme="moments",
        goal={"pose": [0.0, 0.0, 0.85, 3.14159265, 0.0, 0.0]},
        start={"pose": [0.01, 0.0, 0.87, 3.14159265, 0.0, 0.05]},
        target={"size": [0.08, 0.06], "pose": [0.0, 0.0, 0.591, 0.0, 0.0, 0.0],
                "occluder": OCCLUDER, **target},
    )  # fmt: skip


def dark(asked):
    """Stamps and dark pixels of the images of an experiment."""
    seen = []
    loop = Loop(asked, assemble(asked), on_frame=lambda of, one: seen.append(
        (one.stamp, int((FeatureExtractor.decode_image(one).grey < 100).sum()))))  # fmt: skip
    loop.run_to_end()
    goal = loop.parts.goal
    loop.close()
    return np.array(seen).T, goal


@pytest.mark.parametrize(("plant", "target"), [
    ("free", {"shape": "heptagon"}),
    ("bullet", {"shape": "square", "motion": {"velocity": [0.02, 0.01, 0, 0, 0, 0]}}),
])  # fmt: skip
def test_it_lies_there_at_its_times_and_no_other(plant, target):
    (stamps, with_it), goal = dark(experiment(plant, occluded=TIMES, **target))
    (_, without), same = dark(experiment(plant, occluder=None, **target))
    covered = with_it < 0.93 * without
    wanted = np.any([(stamps > a) & (stamps <= b) for a, b in TIMES], axis=0)
    assert wanted.any() and (~wanted).any()
    np.testing.assert_array_equal(covered, wanted)
    assert goal.moments.m00 == pytest.approx(same.moments.m00, rel=1e-6)  # taught without it


def test_the_sun_shines_at_its_times_and_no_other():
    """At 0 s it does not: so the goal is taught, in what the ambient light leaves."""
    asked = experiment("bullet", shape="poster", occluder=None)
    asked = replace(asked, scheme="luminance", start=asked.goal, sun=SunSpec(shines=TIMES))
    seen = []
    loop = Loop(asked, assemble(asked), on_frame=lambda of, one: seen.append(
        (one.stamp, float(FeatureExtractor.decode_image(one).grey.mean()))))  # fmt: skip
    state = loop.run_to_image()
    assert np.abs(state.scheme_output.error).max() < 2.0  # grey levels, at the goal's own pose
    loop.run_to_end()
    loop.close()
    stamps, grey = np.array(seen).T
    shines = np.any([(stamps > a) & (stamps <= b) for a, b in TIMES], axis=0)
    assert shines.any() and (~shines).any()
    np.testing.assert_array_equal(grey > 1.5 * grey[0], shines)


def test_a_sun_that_is_gone_by_the_first_image_has_lit_the_goal():
    asked = experiment("bullet", shape="poster", occluder=None)
    asked = replace(asked, scheme="luminance", start=asked.goal, sun=SunSpec(shines=((0.0, 0.02),)))
    loop = Loop(asked, assemble(asked))
    assert np.abs(loop.run_to_image().scheme_output.error).max() > 50.0
    loop.close()


@pytest.mark.parametrize(("target", "complaint"), [
    ({"occluded": [[0.1, 0.2]]}, "set target.occluder"),
    ({"occluder": OCCLUDER, "occluded": [[0.2, 0.1]]}, "the interval 0.2 to 0.1 s, must be"),
    ({"occluder": OCCLUDER, "occluded": [[-0.2, 0.1]]}, "must be 0 <= start < end"),
])  # fmt: skip
def test_times_that_cannot_be_are_refused(target, complaint):
    with pytest.raises(ExperimentError, match=complaint):
        TargetSpec(shape="square", **target)
