"""ROS interface of cameras: images, compressed images, CameraInfo, labels and frames."""
