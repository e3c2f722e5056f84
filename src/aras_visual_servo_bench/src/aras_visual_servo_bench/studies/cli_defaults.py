"""Defaults that the help of the command line prints. This module imports no library."""

# number of chunks (groups of runs) per worker after which all workers are restarted
CHUNKS_BEFORE_RESTART = 500
