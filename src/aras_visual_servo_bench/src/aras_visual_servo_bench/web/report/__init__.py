"""What a run was worth: numbers, curves, tables and one page, without ROS."""
