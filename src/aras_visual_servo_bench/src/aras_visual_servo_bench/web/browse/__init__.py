"""The results browser: a web page that filters, plots and opens the runs of many studies."""
