"""The ground package: what every other package needs and none of them owns. It knows no ROS."""
