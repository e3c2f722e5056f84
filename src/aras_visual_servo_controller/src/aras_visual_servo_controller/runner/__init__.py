"""The loop in time: joint states and images with their stamps, commands between them."""
