"""User-defined target 'package.module:Class', and the registry of shipped targets."""

import numpy as np
import pytest

from aras_visual_servo_base.settings import parameter
from aras_visual_servo_bench.errors import ExperimentError
from aras_visual_servo_bench.experiment.experiment import Experiment
from aras_visual_servo_bench.experiment.loop_settings import make_loop_settings
from aras_visual_servo_bench.runner.loop import run
from aras_visual_servo_bench.targets.geometry import PolygonTarget
from aras_visual_servo_bench.targets.shapes import SHAPES, FlatShape, OutlineShape, TargetShape
from aras_visual_servo_bench.targets.target_factory import (
    find_default_size,
    find_tracker,
    is_solid,
    make_target,
)


class Kite(OutlineShape):
    corners = ((-0.5, 0.0), (0.1, -0.3), (0.5, 0.05), (0.0, 0.4))


class Blob(FlatShape):
    tracker = "dots"
    marker: str = parameter("", help="number")

    def make(self):
        return PolygonTarget(((0.0, 0.0), (self.size[0], 0.0), (0.0, float(self.marker or 1))))


class Broken(TargetShape):
    def make(self):
        raise KeyError("corner")


class Empty(TargetShape):
    def make(self):
        return None


KITE, BLOB = f"{__name__}:Kite", f"{__name__}:Blob"


def test_a_target_of_one_s_own_is_servoed_to():
    for shape in (Kite, KITE):
        result = run(Experiment(
            plant="free", features="exact", scheme="points", duration=4.0, gain=2.0,
            target={"shape": shape, "size": [0.2, 0.2]}, goal={"pose": [0, 0, -0.6, 0, 0, 0]},
            start={"pose": [0.05, -0.04, -0.8, 0.1, -0.05, 0.3]}))
        assert result.converged and result.verdict.is_reached
    np.testing.assert_allclose(
        make_target(KITE, (0.1, 0.2)).vertices()[1], (0.01, -0.06, 0.0), atol=1e-12)


def test_it_gets_its_parameters_and_its_tracker():
    assert make_target(BLOB, (0.3, 0.1), None, "7").corners[1:] == ((0.3, 0.0), (0.0, 7.0))
    assert make_target(BLOB).corners[1:] == ((0.2, 0.0), (0.0, 1.0))
    assert find_tracker(BLOB) == "dots" and not is_solid(BLOB)
    settings = make_loop_settings(Experiment(plant="free", target={"shape": BLOB}))
    assert settings.tracker == "dots"
    marked = {"shape": BLOB, "marker": "5"}
    experiment = Experiment(plant="free", features="images", target=marked)
    assert experiment.target.placed_target.shape.corners[2] == (0.0, 5.0)


@pytest.mark.parametrize(("target", "why"), [
    ({"shape": f"{__name__}:Kit"}, "has no Kit: did you mean 'Kite'"),
    ({"shape": f"{__name__}:PolygonTarget"}, "Target is not a class derived from"),
    ({"shape": "no_such_package.module:Kite"}, "cannot import no_such_package.module"),
    ({"shape": KITE, "marker": "5"}, "target.marker applies only to a target that shows markers"),
    ({"shape": KITE, "size": (0.1,)}, r"target.size is \[0.1\], must be two lengths"),
    ({"shape": KITE, "size": (0.1, -0.1)}, r"target.size\[1\] is -0.1, must be > 0"),
    ({"shape": f"{__name__}:Broken"}, "Broken': its method make raised KeyError: 'corner'"),
    ({"shape": f"{__name__}:Empty"}, "make returned NoneType, must return a Target")])  # fmt: skip
def test_what_cannot_be_made_is_one_line(target, why):
    with pytest.raises(ExperimentError, match=why):
        _ = Experiment(plant="free", features="images", target=target).target.placed_target


def test_every_entry_declares_its_parameters():
    for name in SHAPES:
        for one in SHAPES.list_parameters(name):
            assert one.name in ("size", "marker") and one.help, (name, one)
        if any(one.name == "size" for one in SHAPES.list_parameters(name)):
            make_target(name, find_default_size(name))  # of as many lengths as it takes
    assert find_default_size("a.svg") is find_default_size("b.stl") is None
