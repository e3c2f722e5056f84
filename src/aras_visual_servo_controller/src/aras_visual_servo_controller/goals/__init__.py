"""Goals and start poses of the camera."""
