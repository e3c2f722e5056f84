"""Common library of all other packages; it does not use ROS."""
