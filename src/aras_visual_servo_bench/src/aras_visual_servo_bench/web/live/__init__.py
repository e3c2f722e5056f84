"""The live page of a running graph: its server, its messages and its robot model, without ROS."""
