"""A public robot: the UR5 of the package example-robot-data is simulated without changes, with a
camera at its tool.
"""

import importlib.util
import sys
from pathlib import Path

import yaml
from output import folder, report_runs

from aras_visual_servo_bench import Experiment

package = importlib.util.find_spec("cmeel")
share = Path(package.origin).parents[1] / "cmeel.prefix" / "share" if package else Path()
ur5 = share / "example-robot-data" / "robots" / "ur_description" / "urdf" / "ur5_robot.urdf"
if not ur5.is_file():
    sys.exit("the descriptions are missing: run pip install example-robot-data")
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
controllers = {"joint_state_controller": {"type": "joint_state_controller/JointStateController",
                                          "publish_rate": 200}}  # fmt: skip
controllers |= {f"{joint}_controller": {"type": "position_controllers/JointPositionController",
                                        "joint": f"{joint}_joint"} for joint in JOINTS}  # fmt: skip
config = folder() / "ur5_controllers.yaml"
config.write_text(yaml.safe_dump(controllers))

# The package:// URLs of the meshes are searched in the folder `share`.
robot = {"urdf": str(ur5), "config": str(config), "camera_frame": "tool0", "search": [str(share)]}
mine = Experiment(
    robot=robot, camera={"width": 320, "height": 240, "horizontal_fov": 1.2},
    target={"shape": "l_shape", "size": [0.12, 0.09], "pose": [0.5, 0.1, 0.001, 0, 0, 0.2]},
    goal={"pose": [0.5, 0.1, 0.35, 3.14159, 0, 0.2]},
    start={"pose": [0.45, 0.0, 0.45, 3.0, 0.1, 0.6]}, scheme="points", gain=2.0,
)  # fmt: skip
run, = report_runs({"UR5": mine}, "camera_path")
assert run.is_success
