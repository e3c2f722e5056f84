"""Record of a run, and its sources: the runner, a bag or a running ROS graph."""
