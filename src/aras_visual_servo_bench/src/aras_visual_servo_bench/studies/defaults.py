"""Defaults that the help of the command line prints; importing them imports no library."""

CHUNKS_BEFORE_RESTART = 500  # chunks per worker after which all workers are restarted
