"""What speaks ROS: the demo and the bags."""
