"""A comparison of schemes: one report compares the schemes moments, points and points_3d from the
same start.
"""

from output import report_runs

from aras_visual_servo_bench import Experiment

names = ("moments", "points", "points_3d")
runs = report_runs({name: Experiment(scheme=name, start="2016") for name in names}, "camera_path")
assert all(run.verdict.is_reached for run in runs)
