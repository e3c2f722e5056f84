"""3-D drawing of a run for rviz and for the web pages, without ROS.

A drawing consists of shapes, such as curves, arrows and texts."""
