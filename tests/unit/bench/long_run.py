"""A long run made from a short one, whose last images and joint states repeat."""

from dataclasses import replace

import numpy as np
from made_run import made_run

from aras_visual_servo_bench.recording.camera_record import CameraRecord
from aras_visual_servo_bench.recording.run import Run

LAST = 30  # images and joint states that repeat


def make_long_run(count: int, duration: float, name: str = "bag") -> Run:
    """Make a run of `count` images and joint states that settles in its first seconds."""
    base = made_run(3, 1.6)
    n, m = len(base.states), len(base.joint_stamp)

    def extend(stamps):
        rest = count - len(stamps)
        period = (duration - (stamps[-1] - stamps[0])) / rest
        return np.concatenate([stamps, stamps[-1] + period * np.arange(1, rest + 1)])

    stamp, joint_stamp = extend(base.stamp), extend(base.joint_stamp)
    images = np.concatenate([np.arange(n), n - LAST + np.arange(count - n) % LAST])
    joints = np.concatenate([np.arange(m), m - LAST + np.arange(count - m) % LAST])
    states = [replace(base.states[i], stamp=float(t)) for i, t in zip(images, stamp, strict=True)]
    return replace(
        base, states=tuple(states), pose=base.pose[images], joint_stamp=joint_stamp, name=name,
        measured_positions=base.measured_positions[joints],
        measured_velocities=base.measured_velocities[joints],
        joint_commands=base.joint_commands[joints], true_pose=base.true_pose[joints],
        cameras={"camera": CameraRecord(base.camera, stamp, stamp + 0.004)},
    )  # fmt: skip
