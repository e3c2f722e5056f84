"""Numbers that describe runs: metrics, statistics and summaries."""
