"""From a recorded run to numbers, plots and a table: what the demo shows at its end."""
