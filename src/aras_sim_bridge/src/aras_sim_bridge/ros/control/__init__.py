"""Controllers on the graph: their manager's services, command and state topics, actions."""
