"""What ros_control was: joints, limits, drives, controllers, and the loop that runs them."""
