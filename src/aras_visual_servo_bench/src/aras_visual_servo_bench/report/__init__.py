"""What a run was worth: numbers, tables and plots, without ROS."""
