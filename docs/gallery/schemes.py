"""A comparison of schemes: moments, points and a pose, from one start, on one page."""

from keeping import keep_runs

from aras_visual_servo_bench import Experiment

names = ("moments", "points", "points_3d")
runs = keep_runs({name: Experiment(scheme=name, start="2016") for name in names}, "camera_path")
assert all(run.verdict.is_reached for run in runs)
