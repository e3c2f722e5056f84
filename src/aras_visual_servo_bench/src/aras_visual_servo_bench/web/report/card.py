"""Card of a run for notebooks: outcome, last image, error curve and main numbers, as HTML."""

from __future__ import annotations

import base64
import textwrap
from html import escape

import numpy as np

from ...metrics.summary import summarise
from ...plots import style, time_plots
from ...plots.palette import BAD, GOOD, SOFT_INK
from ...plots.panels import make_error_panels
from ...plots.time_plots import Layout
from ...recording.film import decode_frame, encode_small_frame
from ...recording.run import Run
from ...recording.run_presentation import describe_verdict
from .page import render_tiles

MAX_TEXT = 400  # largest number of characters of a reason, a remedy or a note
MAX_NOTES = 3
MIN_CURVE_IMAGES = 2
PANEL_HEIGHT, DPI = 1.9, 60  # inches, and pixels per inch of the curve
# A camera that has moved less than this, m and rad, has not moved.
NO_MOTION = 1e-9


def make_card(run: Run) -> str:
    """Return the HTML of a run's card, of less than 100 kB and without external resources.

    If the run has no data for a part of the card, a line gives the reason.
    """
    colour = GOOD if run.is_success else BAD
    image, curve = _render_image(run), _render_curve(run)
    lines = [
        f'<div style="font-size:1.1em"><b style="color:{colour}">{_format_text(run.outcome)}</b>'
        f"&ensp;{escape(describe_verdict(run.verdict))}</div>",
        *(f"<div>{title}: {_format_text(text)}</div>"
          for title, text in (("Reason", run.reason), ("Remedy", run.remedy)) if text),
        f'<div style="display:flex;flex-wrap:wrap;gap:12px;align-items:center">{image}{curve}'
        "</div>" if image or curve else "",
        _render_numbers(run),
    ]  # fmt: skip
    remarks = [*explain_missing_data(run), *run.notes[:MAX_NOTES]]
    if len(run.notes) > MAX_NOTES:
        remarks.append(f"{len(run.notes) - MAX_NOTES} more notes in run.notes")
    lines += [f'<div style="color:{SOFT_INK}">{_format_text(text)}</div>' for text in remarks]
    return f'<div style="max-width:56em">{"".join(lines)}</div>'


def explain_missing_data(run: Run) -> list[str]:
    """Return a sentence for each part of the card that the run has no data for."""
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
        if (lost := count - 1 - last) > 1:  # the last image of a timed-out run is never measured
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


def _format_text(text: str) -> str:
    return escape(textwrap.shorten(str(text), MAX_TEXT, placeholder=" …"))


def _render_image(run: Run) -> str:
    """Return the last image of the control camera; '' without images."""
    record = run.control_record
    if record.images:
        stamp, image = record.images[-1]
    elif record.film:
        stamp, image = record.film[-1][0], decode_frame(record.film[-1][1])
    else:
        return ""
    text = f"last image, {stamp - run.start_stamp:.2f} s"
    return (f'<figure style="margin:0">{_embed("jpeg", encode_small_frame(image), text, 240)}'
            f'<figcaption style="color:{SOFT_INK}">{text}</figcaption></figure>')  # fmt: skip


def _render_curve(run: Run) -> str:
    """Return the norm of the errors over time; '' with less than two measurements."""
    if np.isfinite(run.error).all(axis=1).sum() < MIN_CURVE_IMAGES or not run.names:
        return ""
    panels = make_error_panels([run])[-1:]  # the last of the error panels shows the norm
    with style.apply_style():
        figure = time_plots.draw_panels(panels, [run], "Norm of the errors", Layout(PANEL_HEIGHT))
        if figure is None:
            return ""
        figure.set_dpi(DPI)
        png = figure.make_png()
    return _embed("png", png, "norm of the errors over time", 420)


def _embed(kind: str, content: bytes, text: str, width: int) -> str:
    data = base64.b64encode(content).decode()
    return f'<img alt="{text}" style="width:{width}px" src="data:image/{kind};base64,{data}">'


def _render_numbers(run: Run) -> str:
    """Return the main numbers of the report's page."""
    tiles = render_tiles(summarise(run))
    return "".join(
        f'<span style="display:inline-block;margin-right:1.2em"><b>{escape(tile["value"])}</b> '
        f'<span style="color:{SOFT_INK}">{escape(tile["text"])}</span></span>'
        for tile in tiles
    )
