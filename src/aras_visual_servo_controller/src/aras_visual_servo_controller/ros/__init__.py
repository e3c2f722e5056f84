"""ROS interface of the controller: messages, topics, services and the node."""
