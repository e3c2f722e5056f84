"""The bridge's ROS face: the only subpackage that imports rospy."""
