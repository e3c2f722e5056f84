"""Complete loop of image-based visual servoing with four points and a free camera.

    python docs/examples/four_points.py        # prints the error and the final distance

The parts of the loop are imported from their modules; a project needs only the public `run`.
"""

import numpy as np

from aras_visual_servo_base.poses import matrix_from_xyz_rpy, pose_difference
from aras_visual_servo_bench.plants.free_camera_kinematics import FreeCameraKinematics
from aras_visual_servo_bench.plants.imaging import ImagingSettings, capture
from aras_visual_servo_bench.targets.geometry import PlacedTarget, PolygonTarget
from aras_visual_servo_camera.camera_model import CameraModel
from aras_visual_servo_camera.interaction import Plane
from aras_visual_servo_controller import DifferentialIK, FeatureObserver, Goal, create_scheme
from aras_visual_servo_controller.kinematics.differential_ik import IKSettings, solve_ik
from aras_visual_servo_controller.kinematics.joint_sample import JointSample
from aras_visual_servo_controller.laws import Proportional
from aras_visual_servo_controller.observation.feature_observer import observe
from aras_visual_servo_controller.schemes.scheme_call import compute

PERIOD = 1.0 / 30.0  # s between two images
DEPTH = 0.5  # depth of the target at the goal, m
WORLD_T_GOAL = matrix_from_xyz_rpy((0.0, 0.0, -DEPTH), (0.0, 0.0, 0.0))
WORLD_T_START = matrix_from_xyz_rpy((0.1, -0.05, -0.8), (0.1, -0.1, 0.4))


def main(images: int = 240) -> float:
    """Servo for a number of images; return the final distance from the goal, m."""
    intrinsics = CameraModel(640, 480, (500.0, 0.0, 320.0, 0.0, 500.0, 240.0, 0.0, 0.0, 1.0))
    square = PolygonTarget(((-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)))
    camera = ImagingSettings(intrinsics, PlacedTarget(square, np.eye(4)))
    scheme = create_scheme("points", Proportional(gain=1.5))  # e_dot = -1.5 e, L at each image

    # Teach the goal from the features that the camera measures at the goal pose.
    at_goal = observe(capture(camera, WORLD_T_GOAL), None, FeatureObserver(None, scheme.needs),
                      plane=Plane.fronto_parallel(DEPTH), world_T_camera=WORLD_T_GOAL)
    goal = Goal.teach(scheme, at_goal)
    scheme.check(goal)

    arm = FreeCameraKinematics(WORLD_T_START)  # q (6,) is the logarithm of the displacement
    ik = DifferentialIK(arm, settings=IKSettings.for_free_camera(DEPTH, hold_gain=1.5))
    observer = FeatureObserver(arm, scheme.needs, compute_plane=goal.compute_plane)
    q = np.zeros(6)
    for k in range(images):
        frame = capture(camera, arm.pose(q), round(1e9 * k * PERIOD))
        joints = JointSample.from_values(frame.stamp, arm.names, q)
        observation = observe(frame, joints, observer)
        decision = compute(scheme, observation, goal, frame.stamp)
        q = q + PERIOD * solve_ik(decision.task, q, ik).velocities
        if k % 30 == 0:
            print(f"{frame.stamp:.1f} s: greatest error {np.abs(decision.error).max():.6f}")
    distance, _ = pose_difference(arm.pose(q), WORLD_T_GOAL)
    print(f"{1e3 * distance:.4f} mm from the goal")
    return distance


if __name__ == "__main__":
    main()
