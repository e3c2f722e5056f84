"""What stands behind `tests/mutation AREA`; tests/README.md says what it is for."""
