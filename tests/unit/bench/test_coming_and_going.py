"""Occluders and lights that are present only at given times."""

from dataclasses import replace

import numpy as np
import pytest

from aras_visual_servo_bench import Experiment, Loop, assemble
from aras_visual_servo_bench.experiment.experiment import SunSpec
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


def measure_images(asked, measure):
    """Return the stamps of an experiment's images, a number of each one's grey, and the loop."""
    seen = []
    loop = Loop(asked, assemble(asked), on_frame=lambda of, one: seen.append(
        (one.stamp, float(measure(FeatureExtractor.decode_image(one).grey)))))  # fmt: skip
    loop.run_to_end()
    loop.close()
    return *np.array(seen).T, loop


def is_within_times(stamps):
    found = np.any([(stamps > a) & (stamps <= b) for a, b in TIMES], axis=0)
    assert found.any() and (~found).any()
    return found


@pytest.mark.parametrize(("plant", "target"), [
    ("free", {"shape": "heptagon"}),
    ("bullet", {"shape": "square", "motion": {"velocity": [0.02, 0.01, 0, 0, 0, 0]}}),
])  # fmt: skip
def test_it_lies_there_at_its_times_and_no_other(plant, target):
    (stamps, with_it, loop), (_, without, same) = (
        measure_images(experiment(plant, **keys, **target), lambda grey: (grey < 100).sum())
        for keys in ({"occluded": TIMES}, {"occluder": None})
    )
    np.testing.assert_array_equal(with_it < 0.93 * without, is_within_times(stamps))
    # taught without it
    assert loop.parts.goal.moments.m00 == pytest.approx(same.parts.goal.moments.m00, rel=1e-6)


@pytest.mark.parametrize("shines", [TIMES, ((0.0, 0.02),)])
def test_the_sun_shines_at_its_times_and_the_goal_is_taught_in_the_light_at_0_s(shines):
    asked = experiment("bullet", shape="poster", occluder=None)
    asked = replace(asked, scheme="luminance", start=asked.goal, sun=SunSpec(shines=shines))
    stamps, grey, loop = measure_images(asked, np.mean)
    error = np.abs(loop.make_run().states[0].scheme_output.error).max()  # at the goal's own pose
    if shines is TIMES:
        assert error < 2.0  # grey levels
        np.testing.assert_array_equal(grey > 1.5 * grey[0], is_within_times(stamps))
    else:  # the sun has lit the goal, and is gone by the first image
        assert error > 50.0
