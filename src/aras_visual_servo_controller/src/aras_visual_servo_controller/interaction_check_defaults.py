"""Defaults of the check of interaction matrices.

The help of the command line prints them, so this module imports no library.
"""

# Motion for the finite differences, in rad or as a fraction of the depth. The differences are then
# exact to about 1e-7.
STEP = 1e-4
TOLERANCE = 1e-3
