"""A study: the example runs 64 experiments with different gains and delays, and draws a map of
success with a table of confidence intervals.
"""

import shutil
import subprocess
import sys

from output import folder

out = folder() / "study"
shutil.rmtree(out, ignore_errors=True)
arguments = ["run", "first", "repeats=4", *sys.argv[2:]]  # further overrides, such as gain=[1,2]
bench = [sys.executable, "-m", "aras_visual_servo_bench"]
subprocess.run([*bench, *arguments, "--out", out, "--in-process"], check=True)
shutil.copy(out / "plots" / "success.png", out.parent / "picture.png")
print(f"{out}: show its runs with bench browse")
