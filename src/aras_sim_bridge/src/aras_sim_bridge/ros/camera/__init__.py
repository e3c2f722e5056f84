"""Cameras on the graph: pictures, compressed ones, CameraInfo, labels, frames."""
