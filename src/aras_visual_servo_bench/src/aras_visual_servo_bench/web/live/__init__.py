"""What is to be seen of a running graph: its geometry, its page. No ROS."""
