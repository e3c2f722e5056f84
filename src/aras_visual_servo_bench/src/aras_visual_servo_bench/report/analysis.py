"""Numbers of a run: has it converged, how fast, how near."""

from typing import Any

import numpy as np

from aras_visual_servo_camera.moments import Moments
from aras_visual_servo_controller.errors import MeasurementError
from aras_visual_servo_controller.features.moments import ImageMoments
from aras_visual_servo_controller.goal import Goal
from aras_visual_servo_controller.observation import Observer
from aras_visual_servo_controller.schemes import create_scheme
from aras_visual_servo_controller.state import CONVERGED

from ..run import Verdict
from .recording import Images, Recording

SETTLED = 0.02  # part of the initial error norm
LATE = 1.5  # image periods
REACHED_WITHIN = (0.3e-3, np.radians(0.3))  # m and rad of the camera
FINAL_WINDOW = 1.0  # s over which the final error is averaged


def settling_time(stamp: np.ndarray, error: np.ndarray, part: float = SETTLED) -> float | None:
    """From the first sample until |e| stays under a part of its first value, s; None if never.

    Args:
        stamp: (n,) s.
        error: (n, k).
    """
    norm = np.linalg.norm(error, axis=1)
    above = np.flatnonzero(norm > part * norm[0])
    if above.size == 0:
        return 0.0
    after = int(above[-1]) + 1
    return None if after >= len(stamp) else float(stamp[after] - stamp[0])


def moment_errors(recording: Recording, goal: Goal) -> tuple[np.ndarray, np.ndarray]:
    """Stamps (n,) and errors (n, 4) of xn, yn, an (m) and alpha (rad), whatever the scheme was."""
    feature, observer = ImageMoments(), Observer(None)
    track, camera = recording.moments, recording.images.camera
    stamps, errors = [], []
    for stamp, m, mu in zip(track.stamp, track.m, track.mu, strict=True):
        moments = Moments.from_arrays(m, mu, track.order)
        nearest = int(np.argmin(np.abs(recording.camera_stamp - stamp)))
        seen = observer.of_moments(
            float(stamp), moments, True, "", camera,
            world_T_camera=recording.camera_pose[nearest],
        )  # fmt: skip
        try:
            errors.append(feature.measure(seen, goal).error)
        except MeasurementError:
            continue
        stamps.append(stamp)
    return np.array(stamps), np.array(errors).reshape(-1, 4)


def image_figures(images: Images) -> dict[str, Any]:
    """Rate of the images in simulated time, how many, and how many late or missing.

    Late is an image that the recorder had more than 1.5 periods after its exposure; a gap of
    n periods between two exposures counts as n - 1 late images.
    """
    gaps = np.diff(images.stamp)
    if gaps.size == 0:
        return {"image_rate_hz": None, "images": len(images.stamp), "images_late": 0}
    period = float(np.median(gaps))
    missing = np.maximum(np.round(gaps / period) - 1.0, 0.0).sum()
    late = np.count_nonzero(images.arrival - images.stamp > LATE * period)
    return {
        "image_rate_hz": round(float(gaps.size / (images.stamp[-1] - images.stamp[0])), 3),
        "images": len(images.stamp),
        "images_late": int(missing) + int(late),
    }


def summarise(run: Recording, goal: Goal, **extra: Any) -> dict[str, Any]:
    """The contents of summary.json.

    Args:
        run: what was recorded.
        goal: what was to be reached, as the arm sees it.
        extra: entries of the caller (scheme, start, real_time_factor, versions).
    """
    states = run.states
    stamp, error = moment_errors(run, goal)
    servoing = stamp >= run.began
    stamp, error = stamp[servoing], error[servoing]
    settled = settling_time(states.stamp, states.error)
    late = stamp >= stamp[-1] - FINAL_WINDOW
    final = error[late].mean(axis=0)
    worst = np.abs(error[stamp >= stamp[-1] - 2.0]).max(axis=0)
    verdict = Verdict.of(goal.world_T_camera, run.camera_pose[-1], REACHED_WITHIN)
    names = ImageMoments.names
    return {
        "converged": states.phase[-1] == CONVERGED,
        "outcome": run.outcome or states.phase[-1],
        "verdict": verdict.word,
        "reason": run.reason or states.reason[-1],
        "settling_time_s": None if settled is None else round(settled, 3),
        "final_error": {n: float(f"{v:.3g}") for n, v in zip(names, final, strict=True)},
        "worst_error_last_2_s": {n: float(f"{v:.3g}") for n, v in zip(names, worst, strict=True)},
        "final_camera_error": {
            "position_mm": round(1e3 * verdict.distance, 4),
            "rotation_deg": round(float(np.degrees(verdict.angle)), 4),
        },
        "servoing_time_s": round(float(states.stamp[-1] - states.stamp[0]), 3),
        "smallest_singular_value": float(f"{np.nanmin(states.singular_values):.3g}"),
        **image_figures(run.images),
        **extra,
    }


def tolerances(scheme: str, goal: Goal) -> tuple[float, ...]:
    """Errors that count as reached for the scheme of that name."""
    made = create_scheme(scheme)
    made.check(goal)
    return tuple(made.tolerances)


def table(summary: dict[str, Any]) -> str:
    """The summary in words a person understands."""
    camera, final = summary["final_camera_error"], summary["final_error"]
    settling = summary["settling_time_s"]
    factor = summary.get("real_time_factor")
    rows = [
        ("Target reached", "yes, and held" if summary["converged"] else
         f"NO: {summary['outcome']}" + (f" ({summary['reason']})" if summary["reason"] else "")),
        ("Error under 2 % after", "never" if settling is None else f"{settling:.2f} s"),
        ("Camera off its goal by", f"{camera['position_mm']:.2f} mm, "
         f"{camera['rotation_deg']:.2f} degrees"),
        ("Target off in the view by", f"{1e3 * final['xn']:+.2f} mm right, "
         f"{1e3 * final['yn']:+.2f} mm down"),
        ("Distance off by", f"{1e3 * final['an']:+.2f} mm"),
        ("Turned by", f"{np.degrees(final['alpha']):+.2f} degrees"),
        ("Simulation speed", "not measured" if factor is None else f"{factor:.2f} x real time"),
        ("Camera images", f"{summary['images']} at {summary['image_rate_hz']:.1f} Hz, "
         f"{summary['images_late']} late"),
    ]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"  {name:<{width}}  {value}" for name, value in rows)
