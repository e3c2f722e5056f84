"""Card of a run for notebooks: outcome, last image, error curve and main numbers, as HTML."""

from __future__ import annotations

import base64
import textwrap

import numpy as np

from ...metrics.summary import summarise
from ...plots import style, time_plots
from ...plots.palette import BAD, GOOD, SOFT_INK
from ...plots.panels import make_error_panels
from ...plots.time_plots import Layout
from ...recording.film import decode_frame, encode_small_frame
from ...recording.presentable_run import describe_verdict
from ...recording.run import Run
from .missing_data import MIN_CURVE_IMAGES, explain_missing_data
from .page import ENVIRONMENT, render_tiles

MAX_TEXT = 400  # largest number of characters of a reason, a remedy or a note
MAX_NOTES = 3
# height (inches) and resolution (pixels per inch) of the panel with the error curve
PANEL_HEIGHT, DPI = 1.9, 60


def make_card(run: Run) -> str:
    """Return the HTML of a run's card, of less than 100 kB and without external resources.

    If the run has no data for a part of the card, a line gives the reason.
    """
    record, stamp, image = run.control_record, 0.0, b""
    if record.images:
        stamp, image = record.images[-1][0], encode_small_frame(record.images[-1][1])
    elif record.film:
        stamp, image = record.film[-1][0], encode_small_frame(decode_frame(record.film[-1][1]))
    remarks = [*explain_missing_data(run), *run.notes[:MAX_NOTES]]
    if len(run.notes) > MAX_NOTES:
        remarks.append(f"{len(run.notes) - MAX_NOTES} more notes in run.notes")
    return ENVIRONMENT.get_template("card.html").render(
        colour=GOOD if run.is_success else BAD, quiet=SOFT_INK,
        outcome=_shorten(run.outcome), verdict=describe_verdict(run.verdict),
        explanations=[("Reason", _shorten(run.reason)), ("Remedy", _shorten(run.remedy))],
        image=base64.b64encode(image).decode(),
        image_text=f"last image, {stamp - run.start_stamp:.2f} s",
        curve=base64.b64encode(_draw_curve(run)).decode(), tiles=render_tiles(summarise(run)),
        remarks=map(_shorten, remarks),
    )  # fmt: skip


def _shorten(text: str) -> str:
    return textwrap.shorten(str(text), MAX_TEXT, placeholder=" …")


def _draw_curve(run: Run) -> bytes:
    """Return a plot of the norm of the errors over time as PNG; b'' if less than two are known."""
    if np.isfinite(run.error).all(axis=1).sum() < MIN_CURVE_IMAGES or not run.names:
        return b""
    panels = make_error_panels([run])[-1:]  # the last error panel shows the norm of the errors
    with style.apply_style():
        figure = time_plots.draw_panels(panels, [run], "Norm of the errors", Layout(PANEL_HEIGHT))
        figure.set_dpi(DPI)
        return figure.make_png()
