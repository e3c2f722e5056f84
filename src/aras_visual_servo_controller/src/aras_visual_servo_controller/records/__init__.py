"""Records of the servo loop: states, commands, outcomes and their remedies."""
