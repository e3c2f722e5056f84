"""Your own arm: the example servoes an arm that is defined by a URDF and a YAML file of
controllers, docs/examples/my_arm.urdf.
"""

from output import EXAMPLES, report_runs

from aras_visual_servo_bench import Experiment

# x y z (m), roll pitch yaw (rad) in the world; the camera looks down at the target
mine = Experiment(
    robot={"urdf": str(EXAMPLES / "my_arm.urdf"),
           "config": str(EXAMPLES / "my_arm_controllers.yaml")},
    target={"shape": "l_shape", "size": [0.1, 0.1], "pose": [0.45, 0.05, 0.051, 0, 0, 0]},
    goal={"pose": [0.45, 0.05, 0.35, 3.14159, 0, 0.2]},
    start={"pose": [0.4, 0.0, 0.4, 3.0, 0.1, 0.5]},
    scheme="points", gain=2.0,
)  # fmt: skip
run, = report_runs({"my arm": mine}, "camera_path")
assert run.is_success
