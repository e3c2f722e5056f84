"""Visual features of a camera image and how they move with the camera."""
