"""ROS functions that all nodes of the simulator share."""
