"""The name under which scripts import ros_control's controller manager."""
