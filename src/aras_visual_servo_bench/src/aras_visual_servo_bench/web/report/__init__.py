"""Reports of runs: a page, metrics, figures and tables. This code does not depend on ROS."""
