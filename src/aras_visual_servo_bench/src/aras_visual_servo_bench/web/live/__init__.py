"""The live page, which shows a running ROS graph. This code does not depend on ROS."""
