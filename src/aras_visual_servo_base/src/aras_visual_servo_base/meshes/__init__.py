"""Triangle meshes, and readers of mesh files, which check and cache them."""
