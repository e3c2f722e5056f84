"""The diagnoses of a run, one class a file; `..order` says in which order they are asked."""
