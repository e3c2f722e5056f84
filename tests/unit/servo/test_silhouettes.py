"""Solids servoed by silhouette moments, segmented by label, colour and grey level."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "camera"))

from tracking_scenes import corners_of, write_obj

from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.setup.assembly import assemble

ROUND = "gravity_centre_normalised+area_normalised"  # of what has no main axis
LABEL = {"method": "label"}
LEVEL = 0.59  # m, of the table's top
SIZES = {"box": [0.08, 0.05, 0.06], "sphere": [0.06, 0.06, 0.06]}


def on_the_table(shape, segmentation, seed=4, **more):
    """The arm above a solid, aside from its middle, at most 0.2 m nearer or farther."""
    size = SIZES.get(shape)
    at = LEVEL + 5e-4 + (size[2] / 2 if size else 0.0)
    target = {"shape": shape, "pose": [0.0, 0.0, at, 0.0, 0.0, 0.3]}
    if size:
        target["size"] = size
    return Experiment(**{
        "target": target, "controller_parameters": {"segmentation": segmentation}, "gain": 2.0,
        "duration": 12.0,
        "goal": {"pose": [0.03, -0.02, LEVEL + 0.3, np.pi, 0.0, 0.0]}, "seed": seed,
        "start": {"height": [0.28, 0.4], "side": 0.05, "turn": 0.6, "margin": 4}, **more,
    })  # fmt: skip


def test_a_primitive_is_reached_by_its_labels_silhouette():
    result = run(on_the_table("sphere", LABEL, scheme=ROUND))
    assert result.outcome.startswith("converged")
    assert result.verdict.distance < 1.5e-4
    assert result.verdict.angle < np.radians(0.3)


def test_a_red_box_is_reached_by_its_colour(tmp_path):
    path = write_obj(tmp_path / "red.obj", [(corners_of("box"), 0.6)])
    path.with_suffix(".mtl").write_text("newmtl m0\nKd 0.7 0.1 0.1\n")
    red = {"method": "colour", "colour_low": [170, 100, 30], "colour_high": [10, 255, 255]}
    result = run(on_the_table(str(path), red, scheme="moments"))
    assert result.outcome.startswith("converged")
    assert result.verdict.distance < 3e-4
    assert result.verdict.angle < np.radians(0.3)


def test_a_flying_camera_with_a_lens_tells_by_label():
    asked = on_the_table(
        "box", LABEL, plant="free", features="images", scheme="moments", gain=2.0,
        camera="calibrated", start={"pose": [0.06, -0.05, LEVEL + 0.37, 3.1, 0.04, 0.4]})
    result = run(asked)
    assert result.outcome.startswith("converged")
    assert result.verdict.distance < 1.5e-4


def test_where_no_plane_fits_it_is_said_before_the_run():
    tall = on_the_table("box", LABEL, plant="free", features="images").with_changes(
        target={"shape": "box", "size": [0.08, 0.05, 0.24], "pose": [0.0] * 6},
        goal={"pose": [0.03, 0.03, 0.34, np.pi - 0.3, 0.1, 0.0]})
    with pytest.raises(ExperimentError, match=r"visible outline of box.*22 %.*'model'"):
        assemble(tall)
    assemble(tall.with_changes(scheme="pose")).plant.close()


def told(**segmentation):
    """Return the changes of an experiment whose target is segmented in this way."""
    return {"controller_parameters": {"segmentation": segmentation}}


@pytest.mark.parametrize(("changes", "why"), [
    (told(method="labels"), "segmentation.method is 'labels': did you mean 'label'"),
    (told(component="mask"), "is for the camera node"),
    (told(method="label", label="targt"), "no link has the label 'targt': did you mean 'target'"),
    ({"plant": "free", "features": "images", **told(method="colour")},
     "images of plant 'free' are grey"),
    ({"target": {"shape": "box", "size": [0.1, 0.1], "pose": [0, 0, 0.6, 0, 0, 0]}},
     "must be three lengths, along x, y and z"),
    ({"target": {"shape": "square", "size": [0.1] * 3, "pose": [0, 0, 0.6, 0, 0, 0]}},
     "must be two lengths"),
])  # fmt: skip
def test_what_cannot_be_is_said_in_one_line(changes, why):
    with pytest.raises(ExperimentError, match=why):
        assemble(on_the_table("box", LABEL, scheme="moments").with_changes(**changes))
