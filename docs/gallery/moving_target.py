"""A moving target: with a proportional law, the camera lags behind the target by velocity divided
by gain; with a PI law, it does not lag.
"""

from output import report_runs

from aras_visual_servo_bench import Experiment

target = {"shape": "l_shape", "size": [0.15, 0.1], "motion": {"velocity": [0.02, 0, 0, 0, 0, 0]}}
moving = Experiment(
    plant="free", features="images", target=target, duration=8.0, time_after_convergence=None,
    gain=5.0,
    goal={"pose": [0, 0, 0.4, 3.14159, 0, 0]}, start={"pose": [0.06, -0.04, 0.5, 3.1, 0.05, 0.4]},
)  # fmt: skip
proportional, pi = report_runs(
    {"proportional": moving, "PI": moving.with_changes(law="pi")}, "pose_errors"
)
assert abs(proportional.verdict.distance - 0.02 / 5.0) < 1e-3 and pi.verdict.distance < 1e-3
