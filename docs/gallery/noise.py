"""Exposure and noise: the loop reports the uncertainty of the final camera pose, without and with
noise in the images.
"""

from output import report_runs

from aras_visual_servo_bench import Experiment

dim = {"horizontal_fov": 2.0, "width": 320, "height": 240, "update_rate": 30.0}
light = {"exposure_time": 0.02, "noise_stddev": 8.0, "shot_noise": 0.2}
clean = Experiment(camera=dim, start="2016", duration=5.0, time_after_convergence=1.0)
runs = report_runs(
    {"clean": clean, "20 ms exposure, noise": clean.with_changes(camera={**dim, "effects": light})},
    "pose_errors",
)
assert all(run.converged for run in runs)
