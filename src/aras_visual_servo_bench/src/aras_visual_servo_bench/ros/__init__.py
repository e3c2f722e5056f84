"""ROS nodes and tools: demo, live page, markers, recording and reading of bags."""
