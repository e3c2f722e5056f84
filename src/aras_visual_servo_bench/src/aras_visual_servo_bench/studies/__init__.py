"""Studies: many experiments, one table; each is a command, `python3 -m ...studies.NAME`."""
