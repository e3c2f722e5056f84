"""A run and where it comes from: the runner, a bag, the live graph."""
