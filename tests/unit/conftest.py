"""Shared by the unit tests, which run in as many processes as there are cores."""

import os

# One thread each for BLAS, OpenMP and Mesa, read when they are loaded: several would wait for each
# other at full speed. A matrix exponential of 4 x 4 took 50 times the processor time.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "LP_NUM_THREADS"):
    os.environ.setdefault(name, "1")
