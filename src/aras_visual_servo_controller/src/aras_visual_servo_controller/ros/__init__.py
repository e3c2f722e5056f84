"""The controller's ROS faces: messages in and out, nothing that decides."""
