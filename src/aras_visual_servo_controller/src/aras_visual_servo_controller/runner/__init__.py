"""The loop in time: processing of stamped joint states and images, and sending of commands."""
