"""Colours of figures, reports, the live page and rviz, in the form #rrggbb.

Curves have the colours of Okabe and Ito, which colour-blind readers can distinguish. The contrast
between text and its background is at least 4.5 to 1.
"""

BLUE, VERMILION, GREEN, PURPLE = "#0072b2", "#d55e00", "#009e73", "#cc79a7"
ORANGE, SKY, YELLOW = "#e69f00", "#56b4e9", "#f0e442"

# Colours for a white background. COLOURS contains the colours of the curves in their order.
COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)
START, GOAL, PALE_BLUE = VERMILION, GREEN, "#cfe3f1"
INK, SOFT_INK, GOOD, BAD, WARN = "#202124", "#5f6368", "#00734f", "#b3261e", "#8a5a00"  # of text
FAINT, GRID, GROUND = "#9aa0a6", "#e6e8ea", "#f6f7f8"
# Colour map of values from 0 to 1: nine colours of Matplotlib's viridis.
COLOUR_MAP = ("#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962",
              "#addc30", "#fde725")  # fmt: skip
CURVE_COLOURS = (*COLOURS, "#6b4fbb", "#7a5c00")  # colours of the curves on the report page
REPORT = {
    "ink": INK, "soft": SOFT_INK, "line": GRID, "ground": GROUND, "good": GOOD, "bad": BAD,
    "warn": WARN, "mark": BLUE, "bad-ground": "#fdf3f2", "warn-ground": "#fff8e6",
    "box": "#ffffff", "badge": "#ffffff", "edge": "#8a9099", "cursor": INK, "zero": FAINT,
    **{f"curve-{i}": colour for i, colour in enumerate(CURVE_COLOURS)},
    "colour-map": ", ".join(COLOUR_MAP),
}  # fmt: skip

# Colours of curves on the dark background of the live page and of rviz.
LIVE_CURVES = (SKY, ORANGE, "#00bf8c", PURPLE, YELLOW, "#ff7b5a", "#b4a7ff", "#c8d0dc")
LIVE = {
    # colours of the 3-D drawing; the goal is blue, as in the overlay of the camera image
    "goal": "#3c78ff", "now": "#f2f2f2", "path": ORANGE, "ideal": "#bfc7d9", "feature": YELLOW,
    "desired": VERMILION, "achieved": "#00bf8c", "desired-turn": PURPLE, "achieved-turn": SKY,
    # letters
    "text": "#e6eaf0", "quiet": "#93a0b4", "label": "#c8d0dc", "message": "#ffc9a3",
    "address": "#8fb4ff", "red": "#ff6b5e", "white": "#ffffff",
    # backgrounds
    "back": "#14181f", "box": "#1c222c", "well": "#11151b", "button": "#2a3341", "over": "#344054",
    "active": "#2558cc", "bad": "#8d2f27",
    # colours of status marks: a good state, and one that needs attention
    "ok": "#4cd6a8", "caution": "#e6b450",
    # lines
    "line": "#2d3644", "edge": "#66748b", "zero": "#56627a",
    "grid": "#28303c",
    **{f"curve-{i}": colour for i, colour in enumerate(LIVE_CURVES)},
}  # fmt: skip

# colours of the live page in light mode, with the keys of LIVE; the 3-D drawing stays dark
LIVE_LIGHT = {
    **{name: LIVE[name] for name in ("goal", "now", "path", "ideal", "feature", "desired",
                                     "achieved", "desired-turn", "achieved-turn", "white")},
    "text": INK, "quiet": SOFT_INK, "label": SOFT_INK, "message": WARN, "address": BLUE, "red": BAD,
    "back": GROUND, "box": "#ffffff", "well": "#eceef0", "button": "#ffffff", "over": "#e3edf5",
    "active": BLUE, "bad": BAD, "ok": GOOD, "caution": "#b06f00",
    "line": GRID, "edge": "#868c95", "zero": FAINT, "grid": GRID,
    **{f"curve-{i}": colour for i, colour in enumerate(CURVE_COLOURS)},
}  # fmt: skip

REPORT_DARK = {  # colours of the report page in dark mode, with the keys of REPORT
    "ink": LIVE["text"], "soft": LIVE["quiet"], "line": LIVE["line"], "ground": LIVE["back"],
    "good": LIVE["ok"], "bad": "#ff8a80", "warn": LIVE["caution"], "mark": LIVE["address"],
    "bad-ground": "#33201f", "warn-ground": "#2e2818", "box": LIVE["box"], "badge": LIVE["back"],
    "edge": LIVE["edge"], "cursor": LIVE["white"], "zero": LIVE["zero"],
    **{f"curve-{i}": colour for i, colour in enumerate(LIVE_CURVES)},
    "colour-map": REPORT["colour-map"],
}  # fmt: skip
SCENE = {"start": ORANGE, "goal": "#00bf8c", "ideal": LIVE["ideal"], "face": "#6b7688",
         "rim": LIVE["white"]}  # fmt: skip


def to_rgb(colour: str) -> tuple[float, float, float]:
    """Return the components red, green and blue, 0 to 1, of a colour #rrggbb."""
    red, green, blue = (int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue


def make_css(colours: dict[str, str], selector: str = ":root") -> str:
    """Return a CSS rule that defines a variable for each colour, for the elements of `selector`."""
    return (
        f"{selector} {{ {' '.join(f'--{name}: {value};' for name, value in colours.items())} }}\n"
    )


def contrast_ratio(first: tuple[float, ...], second: tuple[float, ...]) -> float:
    """Compute the contrast of two colours (components 0 to 1) by WCAG 2.

    It is 1 for equal colours, and 21 for black and white.
    """
    light, dark = sorted((_relative_luminance(first), _relative_luminance(second)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def choose_text_colour(colour: tuple[float, ...]) -> str:
    """Return black or white, whichever has the higher contrast with a colour.

    colour: red, green and blue, 0 to 1.
    """
    return max(("#000000", "#ffffff"), key=lambda text: contrast_ratio(to_rgb(text), colour))


def _relative_luminance(colour: tuple[float, ...]) -> float:
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour[:3]]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
