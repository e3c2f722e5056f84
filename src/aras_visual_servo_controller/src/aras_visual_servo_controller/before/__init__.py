"""The loop of one robot and one law, until the node and its tools stand on the new core."""
