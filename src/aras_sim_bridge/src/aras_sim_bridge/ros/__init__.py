"""ROS interface of the simulator; the only subpackage that imports rospy."""
