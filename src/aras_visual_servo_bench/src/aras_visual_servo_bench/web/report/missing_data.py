"""Explanations of what a card or a report cannot show of a run."""

from __future__ import annotations

import numpy as np

from ...recording.run import Run

MIN_CURVE_IMAGES = 2
# Motion up to which a camera counts as at rest, m and rad.
NO_MOTION = 1e-9


def explain_missing_data(run: Run) -> list[str]:
    """Return a sentence for each part of a card or report that the run has no data for."""
    found = []
    count = len(run.states)
    known = np.flatnonzero(np.isfinite(run.error).all(axis=1)) if run.names else np.zeros(0, int)
    measured, last = len(known), int(known[-1]) if len(known) else 0
    if not count:
        found.append("No curve: the loop has processed no image.")
    elif not measured:
        found.append(f"No curve: none of the {count} images has a measurement.")
    elif measured < MIN_CURVE_IMAGES:
        found.append(f"No curve: only 1 of {count} images has a measurement.")
    else:
        if gaps := last + 1 - measured:
            found.append(f"The curve has gaps: {gaps} of {count} images have no measurement.")
        # one image without a measurement at the end is normal, because a run that times out ends
        # with it
        if (lost := count - 1 - last) > 1:
            found.append(f"The last {lost} of {count} images have no measurement.")
    if not run.verdict.name:
        found.append("No verdict: the true poses are unknown.")
    if count > 1 and _is_at_rest(run.pose):
        found.append("The camera has not moved.")
    if not (run.control_record.images or run.control_record.film):
        found.append("No image is stored: run_with_images stores them.")
    return found


def _is_at_rest(poses: np.ndarray) -> bool:
    """Return whether known poses (n, 4, 4) do not differ from the first of them."""
    known = poses[np.isfinite(poses).all(axis=(1, 2))]
    return len(known) > 1 and bool((np.abs(known - known[0]) < NO_MOTION).all())
