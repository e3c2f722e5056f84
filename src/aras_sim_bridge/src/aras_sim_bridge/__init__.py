"""Gazebo's ROS interface over PyBullet."""
