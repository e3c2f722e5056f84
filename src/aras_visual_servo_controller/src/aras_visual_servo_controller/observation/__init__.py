"""Image and joint states in, observations out: pairing by stamps, and the target's geometry."""
