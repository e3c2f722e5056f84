"""`python -m aras_visual_servo_bench`: the command line of the bench."""

import sys

from aras_visual_servo_bench.cli import main

if __name__ == "__main__":
    sys.exit(main())
