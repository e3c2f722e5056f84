"""The results browser: a page to filter, plot and open the runs of many studies."""
