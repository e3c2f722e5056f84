"""ROS interface of controllers: controller_manager services, command and state topics, actions."""
