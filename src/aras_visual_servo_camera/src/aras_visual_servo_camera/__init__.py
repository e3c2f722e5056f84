"""Visual features of camera images, and their interaction matrices."""
