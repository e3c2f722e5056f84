"""Controllers, joint limits, drives, and the control loop, with the behaviour of ros_control."""
