"""A link of the robot description as the target: a crate on a table."""

from pathlib import Path

import numpy as np
import pytest

from aras_visual_servo_base.poses import matrix_from_xyz_rpy
from aras_visual_servo_bench import Experiment, assemble, run
from aras_visual_servo_bench.errors import ExperimentError

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples"
PLACE, TURN, SIZE = (0.45, 0.05, 0.081), 0.3, (0.08, 0.05, 0.06)
CRATE = """<link name="crate"><visual><geometry><box size="{}"/></geometry></visual></link>
<joint name="stands" type="fixed"><parent link="world"/><child link="crate"/>
  <origin xyz="{}" rpy="0 0 {}"/></joint>
<gazebo reference="crate"><material>Gazebo/Black</material></gazebo></robot>"""
GOAL = {"pose": [0.46, 0.03, 0.36, 3.14159, 0.0, 0.2]}
START = {"pose": [0.42, 0.02, 0.42, 3.05, 0.08, 0.5]}


@pytest.fixture
def asked(tmp_path):
    def made(target, **keys):
        crate = CRATE.format(*(" ".join(map(str, part)) for part in (SIZE, PLACE)), TURN)
        text = (EXAMPLES / "my_arm.urdf").read_text().replace("</robot>", crate)
        (tmp_path / "arm.urdf").write_text(text)
        robot = {"urdf": str(tmp_path / "arm.urdf"),
                 "config": str(EXAMPLES / "my_arm_controllers.yaml")}
        return Experiment(robot=robot, target=target, goal=GOAL, start=START, gain=4.0,
                          **{"scheme": "moments", "time_after_convergence": 0.1, **keys})
    return made


def corners(size):
    place = matrix_from_xyz_rpy((*PLACE[:2], 0.0), (0.0, 0.0, TURN))
    return [(place @ [0.5 * a * size[0], 0.5 * b * size[1], 0, 1])[:2].tolist()
            for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]  # fmt: skip


def test_it_is_a_solid_that_is_servoed_to(asked):
    result = run(asked({"link": "crate"}))
    assert result.outcome == "converged up to 180°"  # a box looks alike from either side
    assert result.verdict.is_reached and not result.notes


@pytest.mark.parametrize(("size", "scheme", "factor"), [
    (SIZE, "moments", 2), (SIZE, "points", 2), ([3.0 * side for side in SIZE], "moments", 0),
])  # fmt: skip
def test_flat_corners_of_another_area_than_what_is_drawn_are_refused(asked, size, scheme, factor):
    """They would be seen on z = 0: moments' goal was 0.11 m off, and the run said `converged`."""
    why = rf"target's area in the image is {factor}\.\d+ times .* set target.link"
    with pytest.raises(ExperimentError, match=why):
        assemble(asked({"shape": corners(size)}, scheme=scheme))


@pytest.mark.parametrize("height", [1.0, 9.0])
def test_a_part_of_some_millimetres_in_millimetres_is_said(tmp_path, height):
    """Of 4 mm it would be 4 m long, which a mesh may be: from within, and beyond the view."""
    lines = [f"v {a} {b} {c}" for c in (-1.2, 1.2) for b in (-1.5, 1.5) for a in (-2.0, 2.0)]
    lines += ["f 1 3 4 2", "f 5 6 8 7", "f 1 2 6 5", "f 2 4 8 6", "f 4 3 7 8", "f 3 1 5 7"]
    (tmp_path / "part.obj").write_text("\n".join(lines) + "\n")
    pose = {"pose": [0.1, 0.05, height, np.pi, 0.0, 0.2]}
    why = "the mesh is 4 m long; if it is in millimetres, set target.scale to 0.001"
    with pytest.raises(ExperimentError, match=why):
        assemble(Experiment(
            plant="free", target={"shape": str(tmp_path / "part.obj")}, goal=pose, start=pose,
            scheme="model", camera={"width": 320, "height": 240, "horizontal_fov": 0.4},
            features="exact",
        ))  # fmt: skip
