"""A run as a 3-D drawing, for rviz and for pages: shapes, trajectories and texts. No ROS."""
