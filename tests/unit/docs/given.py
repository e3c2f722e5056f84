"""Objects that code blocks of the documentation assume, by their name in a preceding comment."""

from __future__ import annotations

import ast
import runpy
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from blocks import ROOT

from aras_visual_servo_bench.experiment.cameras import draw_outline
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.features.moments import ImageMoments
from aras_visual_servo_controller.goals.goal import Goal
from aras_visual_servo_controller.kinematics import Arm
from aras_visual_servo_controller.kinematics.joint_sample import JointSample

SQUARE = np.array([[-0.2, -0.1], [0.2, -0.1], [0.25, 0.1], [-0.2, 0.1]])
CONFIG = ROOT / "src" / "aras_visual_servo_controller" / "config"


def loop() -> dict[str, Any]:
    """Return the objects of a user's own loop: goal file, description, image, joints."""
    Path("goal_2016.yaml").write_text((CONFIG / "goal_2016.yaml").read_text())
    urdf = (ROOT / "src/aras_visual_servo_gazebo/robots/aras_visual_servo.urdf").read_text()
    arm, goal = Arm.from_urdf(urdf), Goal.load("goal_2016.yaml")
    focal = 102.74
    camera = CameraModel(320, 240, (focal, 0, 159.5, 0, focal, 119.5, 0, 0, 1))
    joints = JointSample.from_values(0.0, arm.names, goal.get_joints(arm.names))
    picture = draw_outline(goal.target.compute_outline(arm.pose(joints.positions)), camera)
    return dict(urdf=urdf, camera=camera, joints=joints, picture=picture, stamp=0.0, now=0.01)


def moments() -> dict[str, Any]:
    """Return an ImageMoments message, and the desired outline."""
    seen = Moments.from_polygon(0.9 * SQUARE)
    message = types.SimpleNamespace(valid=True, m=seen.m_array, mu=seen.mu_array, order=seen.order)
    return {"corners_at_the_desired_pose": SQUARE, "message": message}


def my_package() -> dict[str, Any]:
    """Register a package my_package with a feature, as a user would write it."""
    module = types.ModuleType("my_package.my_module")
    module.MyFeature = type("MyFeature", (ImageMoments,), {})
    sys.modules.update({"my_package": types.ModuleType("my_package"), module.__name__: module})
    return {}


def four_points() -> dict[str, Any]:
    """Return everything before the loop of docs/examples/four_points.py, for 60 images."""
    path = ROOT / "docs" / "examples" / "four_points.py"
    names = runpy.run_path(str(path)) | {"images": 60}
    (main,) = (node for node in ast.parse(path.read_text()).body
               if isinstance(node, ast.FunctionDef) and node.name == "main")  # fmt: skip
    count = next(i for i, node in enumerate(main.body) if isinstance(node, ast.For))
    before = ast.Module(main.body[:count], type_ignores=[])
    exec(compile(before, str(path), "exec"), names)
    return names


def portal() -> dict[str, Any]:
    """Copy the examples of several cameras."""
    for name in ("portal.yaml", "portal.urdf", "portal_controllers.yaml", "stereo_ibvs.py",
                 "eye_to_hand.py", "both_eyes.yaml"):  # fmt: skip
        Path(name).write_text((ROOT / "docs" / "examples" / name).read_text())
    return {}


GIVEN: dict[str, Callable[[], dict[str, Any]]] = {
    "loop": loop, "moments": moments, "my_package": my_package, "portal": portal,
    "four_points": four_points,
}  # fmt: skip
