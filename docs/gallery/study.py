"""A study: the example runs 64 experiments with different gains and delays, and draws a map of
success with a table of confidence intervals.
"""

import shutil
import sys

from output import folder

from aras_visual_servo_bench.cli import main

out = folder() / "study"
shutil.rmtree(out, ignore_errors=True)
arguments = ["run", "first", "repeats=4", *sys.argv[2:]]  # further overrides, such as gain=[1,2]
if status := main([*arguments, "--out", str(out), "--in-process"]):
    sys.exit(status)
shutil.copy(out / "plots" / "success.png", out.parent / "picture.png")
print(f"{out}: show its runs with bench browse")
