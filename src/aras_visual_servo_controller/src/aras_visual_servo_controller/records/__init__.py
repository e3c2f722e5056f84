"""What the loop leaves of a run: states, commands, outcomes and their remedies."""
