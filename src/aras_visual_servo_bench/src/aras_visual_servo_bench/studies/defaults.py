"""Defaults that the help of the command line prints. This module imports no library."""

# All workers are restarted after this number of chunks per worker.
CHUNKS_BEFORE_RESTART = 500
