"""What every node of the simulator needs of ROS."""
