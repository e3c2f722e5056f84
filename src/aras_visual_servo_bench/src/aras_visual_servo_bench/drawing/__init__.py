"""3-D drawing of a run for rviz and the web pages: shapes, trajectories and texts, without ROS."""
