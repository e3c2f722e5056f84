"""Meshes: read once and checked, by everybody who needs them."""
