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
from ...recording.presentable_run import describe_verdict
from ...recording.run import Run
from .missing_data import MIN_CURVE_IMAGES, explain_missing_data
from .page import render_tiles

MAX_TEXT = 400  # largest number of characters of a reason, a remedy or a note
MAX_NOTES = 3
# height (inches) and resolution (pixels per inch) of the panel with the error curve
PANEL_HEIGHT, DPI = 1.9, 60


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


def _format_text(text: str) -> str:
    return escape(textwrap.shorten(str(text), MAX_TEXT, placeholder=" …"))


def _render_image(run: Run) -> str:
    """Return the last image of the control camera as HTML; '' if the run has no images."""
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
    """Return a plot of the norm of the errors over time as HTML; '' if less than two are known."""
    if np.isfinite(run.error).all(axis=1).sum() < MIN_CURVE_IMAGES or not run.names:
        return ""
    panels = make_error_panels([run])[-1:]  # the last error panel shows the norm of the errors
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
    """Return the main numbers of a run, such as the final errors, as HTML."""
    tiles = render_tiles(summarise(run))
    return "".join(
        f'<span style="display:inline-block;margin-right:1.2em"><b>{escape(tile["value"])}</b> '
        f'<span style="color:{SOFT_INK}">{escape(tile["text"])}</span></span>'
        for tile in tiles
    )
