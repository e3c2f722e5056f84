"""The results browser: the runs of many studies in a page, to be filtered, plotted and opened."""
