"""What a run is worth in numbers: plain values for a table's row."""

from __future__ import annotations

import numpy as np

from aras_visual_servo_controller.arm.poses import inverse, pose_difference, transform

from ..asked.experiment import Experiment
from ..recording.run import Run
from ..targets.geometry import PlacedTarget
from ..targets.outlines import shape_of

DIGITS = 6
REDUCED = 0.1


def measures(experiment: Experiment, result: Run) -> dict[str, object]:
    """Of one run; lengths in m, angles in degrees, times in s, excursion in normalised units.

    iterations: motions until the last image. largest_depth: of the target's origin along the
    optical axis. path_ratio: way of the camera over the straight line. excursion: the farthest
    that a corner of the target has been from the image's middle. settled: see Run.
    """
    poses = result.pose
    spec = experiment.target
    target = PlacedTarget(
        shape_of(spec.shape, spec.size), transform(spec.pose[:3], spec.pose[3:]), spec.motion
    )
    vertices = target.shape.vertices()
    middle = np.array([0.0, 0.0, target.shape.height, 1.0])
    depth, excursion = 0.0, 0.0
    for pose, stamp in zip(poses, result.stamp, strict=True):
        seen = inverse(pose) @ target.world_T_target(float(stamp))
        depth = max(depth, float((seen @ middle)[2]))
        points = vertices @ seen[:3, :3].T + seen[:3, 3]
        if (points[:, 2] > 0.0).all():
            excursion = max(excursion, float(np.abs(points[:, :2] / points[:, 2:]).max()))
    way = float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum()) if len(poses) else 0
    straight = angle = 0.0
    if len(poses):
        straight, angle = pose_difference(result.goal_pose, poses[0])
    # The criterion of the rendered protocols: both are less than a tenth of what they were.
    reduced = bool(
        result.verdict.distance <= REDUCED * straight and result.verdict.angle <= REDUCED * angle
    )
    return {
        "outcome": result.outcome,
        "verdict": result.verdict.word,
        "iterations": max(len(result.stamp) - 1, 0),
        "largest_depth": round(depth, DIGITS),
        "distance": float(f"{result.verdict.distance:.6g}"),
        "angle": float(f"{np.degrees(result.verdict.angle):.6g}"),
        "settled": round(result.settled(), 3),
        "path": round(way, DIGITS),
        "path_ratio": round(way / straight, 4) if straight > 1e-6 else "",
        "excursion": round(excursion, 4),
        "start_distance": round(straight, DIGITS),
        "reduced": reduced,
        "start_angle": round(float(np.degrees(angle)), 4),
        "reason": result.reason,
    }
