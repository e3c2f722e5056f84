"""Triangle meshes, and cached, checked readers of mesh files."""
