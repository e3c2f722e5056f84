"""Stand-in for ros_control's Python package controller_manager."""
