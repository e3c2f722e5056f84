"""Diagnosis of a run: whether the camera has arrived, and if not, why and what to change."""
