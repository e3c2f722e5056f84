"""Reports of runs: a page, metrics, figures and tables, without ROS."""
