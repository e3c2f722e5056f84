"""Data of the laboratory robot, from the description of the original simulator.

Metres, kilograms, radians, N, N m. The tests of this folder hold our files against them.
"""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = ROOT / "src" / "aras_visual_servo_gazebo"
URDF = PACKAGE / "robots" / "aras_visual_servo.urdf"

# joint: (type, parent, child, xyz, rpy, axis, (lower, upper, effort, velocity),
#         (damping, friction))
ARM_LIMITS = (-2.0943, 2.0943, 50000, 5)
SIDEWAYS = (1.5708, 0, -1.5708)
JOINTS = {
    "gantry": ("prismatic", "base_link", "slider", (0, 0, 1.6263), SIDEWAYS, (0, 0, -1),
               (-1.5, 1.5, 80000, 5), (0.8, 0.5)),
    "J0": ("fixed", "slider", "link0", (0, -0.02888, 0), (-1.5708, 0, 3.1416), None, None, None),
    "J1": ("revolute", "link0", "link1", (0, 0, 0.168), (0, 0, 0), (0, 0, 1), ARM_LIMITS,
           (0.7, 0.9)),
    "J2": ("revolute", "link1", "link2", (0, 0, 0.132), (0, 0, 0), (0, 1, 0), ARM_LIMITS,
           (0.1, 0.9)),
    "J3": ("revolute", "link2", "link3", (0, 0, 0.25), (0, 0, 0), (0, 1, 0), ARM_LIMITS,
           (0.9, 0.9)),
    "J5": ("revolute", "link3", "link5", (0, 0, 0.16), (0, 0, 3.1416), (0, -1, 0), ARM_LIMITS,
           (0.9, 0.9)),
    "J6": ("revolute", "link5", "link6", (0, 0, 0.0718), (0, 0, -3.1416), (0, 0, 1),
           (-3000, 3000, 50000, 5), (0.1, 0.9)),
    "camera_joint": ("fixed", "link6", "camera_link", (0, 0, 0.0334), (3.14, -1.57, 0), None, None,
                     None),
}  # fmt: skip

# link: (mass, com, ixx iyy izz, ixy ixz iyz)
INERTIALS = {
    "base_link": (
        1729.39, (0.01605, 0.38072, -0.00071), (475.397, 1072.78, 1103.62), (34.566, -1.799, -1.692)
    ),
    "slider": (1.5957, (0, -0.0079955, -0.00255), (0.0042058, 0.0076559, 0.0044974), (0, 0, 0)),
    "link0": (5.272, (-0.03889, 0, 0.07653), (0.021924, 0.032682, 0.030507), (0, 0.0018667, 0)),
    "link1": (2.2792, (-0.007172, 0, 0.080508), (0.0091615, 0.0096145, 0.0051301), (0, 0, 0)),
    "link2": (3.6544, (-0.00045943, 0, 0.11501), (0.039615, 0.02958, 0.015467), (0, 0, 0)),
    "link3": (1.6841, (0, -0.0003295, 0.069078), (0.0082866, 0.0076034, 0.0027866), (0, 0, 0)),
    "link5": (1.32285, (0, 0, -0.0052055), (0.00029998, 0.00041146, 0.00021741), (0, 0, 0)),
    "link6": (0.3641, (0, 0, 0.0076492), (0.00031783, 0.0003178, 0.00043046), (0, 0, 0)),
    "camera_link": (0.1, (0, 0, 0), (1e-6, 1e-6, 1e-6), (0, 0, 0)),
}  # fmt: skip

# link: bounds of its shape in its own frame, (x0, x1), (y0, y1), (z0, z1)
BOUNDS = {
    "base_link": ((-1.2, 1.43), (-0.68, 0.68), (0, 1.75)),
    "slider": ((-0.0762, 0.0762), (-0.029, 0.032), (-0.0762, 0.0762)),
    "link0": ((-0.169, 0.082), (-0.093, 0.093), (0, 0.168)),
    "link1": ((-0.0775, 0.0775), (-0.0775, 0.0775), (0, 0.1945)),
    "link2": ((-0.062, 0.062), (-0.088, 0.088), (-0.062, 0.298)),
    "link3": ((-0.0475, 0.0475), (-0.058, 0.058), (-0.0475, 0.201)),
    "link5": ((-0.042, 0.042), (-0.022, 0.022), (-0.057, 0.046)),
    "link6": ((-0.045, 0.045), (-0.045, 0.045), (-0.026, 0.033)),
}

# link: (box size, centre)
BOXES = {"camera_link": ((0.01, 0.09, 0.09), (0, 0, 0))}

# The target: sizes and centres of its plates, where the original has them in base_link.
PLATES = (
    ((0.05, 0.05, 0.001), (0, 0, 0.59)),
    ((0.025, 0.025, 0.0005), (-0.005, -0.025, 0.5905)),
)

REDUCTIONS = {"gantry": 50, "J1": 100, "J2": 100, "J3": 10, "J5": 10, "J6": 10}

# controller: (joint, p, i, d, i_clamp)
GAINS = {
    "gantry_position_controller": ("gantry", 15000, 5, 400, 1000),
    "joint1_position_controller": ("J1", 3000, 40, 40, 1000),
    "joint2_position_controller": ("J2", 7000, 1000, 165, 1000),
    "joint3_position_controller": ("J3", 4000, 200, 0, 1000),
    "joint5_position_controller": ("J5", 3500, 150, 0, 1000),
    "joint6_position_controller": ("J6", 70, 2, 0, 1000),
}
