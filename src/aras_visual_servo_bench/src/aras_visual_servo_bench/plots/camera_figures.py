"""Figures of the image plane, of images at selected times, and of the camera's path in space."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ..recording.image_tracks import ImageTracks, compute_tracks, find_milestones
from ..recording.run import Run
from .palette import COLOURS, FAINT, GOAL, GRID, INK, START
from .style import (
    Margins,
    add_legend_below,
    add_title,
    escape_math,
    find_figure_width,
    is_paper,
    make_axes,
)
from .time_plots import make_curve_styles

# the contrast of an image is multiplied by this factor, so that curves on it are more visible
IMAGE_CONTRAST = 0.35
MIN_AXIS_RATIO = 0.35  # smallest length of an axis of a 3-D view, relative to the longest axis
# A 3-D view is tall if its height, divided by its larger horizontal side, is above this value.
MAX_HEIGHT_RATIO = 1.5
FRUSTUM_SIZE = 0.12  # length of a drawn camera, relative to the longest axis of the 3-D view
LEGEND_HEIGHT = 0.5  # height of the legend of the camera's path, inches
# Size of the drawn camera at the goal relative to the drawn camera at the end of the path. If both
# had one size, the camera at the end would hide the camera at the goal.
GOAL_FRUSTUM_SCALE = 1.5
IMAGE_MARGIN = 0.03  # margin around the block of images of a figure, inches
TITLE_HEIGHT = 0.3  # height of the title above each image, inches
IMAGE_GAP = 0.07  # distance between two images, inches


def draw_image_trajectory(runs: Sequence[Run]) -> Figure | None:
    """Draw the paths of the target's points in the image.

    The background is the last image of the first run. Return None if no run has such paths.
    """
    found = [(run, compute_tracks(run)) for run in runs]
    found = [(run, tracks) for run, tracks in found if tracks is not None]
    if not found:
        return None
    camera = found[0][0].camera
    width = plt.rcParams["figure.figsize"][0]
    part = 0.66 if is_paper() else 1.0
    figure, (axis,) = make_axes(
        1, (width / part - 0.97) * camera.height / camera.width,
        margins=Margins(0.85, 0.12, 0.36, 0.89),
    )  # fmt: skip
    axis.grid(False)
    for side in axis.spines.values():
        side.set_visible(True)
    images = found[0][0].control_record.images
    if images and images[-1][1].shape[:2] == (camera.height, camera.width):
        axis.imshow((255.0 - IMAGE_CONTRAST * (255.0 - images[-1][1])).astype(np.uint8))
    styles = make_curve_styles(len(found))
    for number, (run, tracks) in enumerate(found):
        _draw_tracks(axis, run, tracks, None if len(found) == 1 else styles[number])
    axis.set(xlabel="column (pixel)", ylabel="row (pixel)", aspect="equal",
             xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5))  # fmt: skip
    if len(found) == 1:
        tracks = found[0][1]
        handles = [
            Line2D([], [], marker="o", ls="", color=START, ms=6, label="start"),
            Line2D([], [], marker="o", ls="", mfc="none", mec=GOAL, mew=1.6, ms=9, label="goal"),
        ]
        if len(tracks.names) <= 6:
            handles = [Line2D([], [], color=_choose_colour(tracks, i), label=escape_math(name))
                       for i, name in enumerate(tracks.names)] + handles  # fmt: skip
        measured, other = "points that the scheme measures", "target's corners and centre"
        add_title(axis, f"Path of the {measured if tracks.is_measured else other} in the image")
    else:
        handles = [Line2D([], [], label=escape_math(run.name), **style)
                   for (run, _), style in zip(found, styles, strict=True)]  # fmt: skip
        add_title(axis, "Paths of the target in the image")
    add_legend_below(figure, 5, handles)
    return figure


def _choose_colour(tracks: ImageTracks, i: int) -> str:
    """Return the colour of the path of the point with the index i.

    Points that a scheme measures have different colours. If the points are the target's corners and
    centre instead, only the path of the centre is coloured.
    """
    if not tracks.is_measured:
        return COLOURS[0] if tracks.names[i].startswith("centre") else FAINT
    return COLOURS[i % len(COLOURS)]


def _draw_tracks(
    axis: Axes, run: Run, tracks: ImageTracks, style: dict[str, object] | None
) -> None:
    for i in range(len(tracks.names)):
        pixels = tracks.pixels[:, i]
        known = np.isfinite(pixels).all(axis=1)
        if not known.any():
            continue
        is_main = tracks.is_measured or tracks.names[i].startswith("centre")
        shown = pixels[known]
        emphasis = {"alpha": 1.0 if is_main else 0.8, "zorder": 4 if is_main else 3}
        if style is None:
            curve_style = {"color": _choose_colour(tracks, i), "lw": 1.8 if is_main else 0.9}
        else:
            curve_style = style if is_main else {**style, "lw": 0.5 * style["lw"], "marker": ""}
        axis.plot(*shown.T, **{**curve_style, **emphasis})
        axis.plot(*shown[0], "o", color=START if style is None else style["color"],
                  ms=6 if is_main else 3, zorder=5)  # fmt: skip
        if np.isfinite(tracks.desired[i]).all():
            axis.plot(*tracks.desired[i], "o", mfc="none", mec=GOAL, mew=1.6 if is_main else 0.9,
                      ms=9 if is_main else 5, zorder=6)  # fmt: skip


def draw_filmstrip(runs: Sequence[Run]) -> Figure | None:
    """Draw the images that `find_milestones` selects, with the desired outline of the target.

    Return None if no run has images.
    """
    runs = [r for r in runs if r.control_record.images]
    if not runs:
        return None
    strips = [(r, find_milestones(r) or [r.control_record.images[0][0]]) for r in runs]
    columns = max(len(stamps) for _, stamps in strips)
    shape = runs[0].control_record.images[0][1].shape
    part = 0.66 if is_paper() else 1.0
    room = find_figure_width(is_wide=True) / part - 2.0 * IMAGE_MARGIN - (columns - 1) * IMAGE_GAP
    figure, axes = make_axes(
        len(runs) * columns, room / columns * shape[0] / shape[1], columns, is_wide=True,
        margins=Margins(
            IMAGE_MARGIN, IMAGE_MARGIN, TITLE_HEIGHT, IMAGE_MARGIN, TITLE_HEIGHT, IMAGE_GAP
        ),
    )  # fmt: skip
    for number, (run, stamps) in enumerate(strips):
        row = axes[number * columns : (number + 1) * columns]
        for axis in row[len(stamps) :]:
            axis.set_visible(False)
        desired_outline = run.project_desired_outline()
        for axis, stamp in zip(row, stamps, strict=False):
            axis.imshow(run.control_record.find_nearest_image(stamp))
            axis.set(xticks=[], yticks=[])
            axis.grid(False)
            for side in axis.spines.values():
                side.set(visible=True, color=FAINT, linewidth=0.6)
            if desired_outline is not None:
                axis.plot(*np.vstack([desired_outline, desired_outline[:1]]).T, color=GOAL, lw=1.1)
            axis.set(xlim=(-0.5, shape[1] - 0.5), ylim=(shape[0] - 0.5, -0.5))
            axis.set_title(f"{stamp - run.start_stamp:.2f} s", fontweight="normal", loc="center",
                           fontsize=7 if is_paper() else 10, pad=3)  # fmt: skip
        if len(runs) > 1:
            row[0].text(0.03, 0.95, escape_math(run.name), transform=row[0].transAxes, va="top",
                        fontsize=7 if is_paper() else 10,
                        bbox={"facecolor": "white", "alpha": 0.7, "pad": 0.5, "lw": 0})  # fmt: skip
    return figure


def draw_camera_path(runs: Sequence[Run]) -> Figure | None:
    """Draw the camera's path in the world, the straight path to the goal, and the target.

    Return None if no run has a path.
    """
    runs = [r for r in runs if len(select_servoing_poses(r))]
    if not runs:
        return None
    width, part = find_figure_width(), 0.66 if is_paper() else 1.0
    figure, (axis,) = make_axes(
        1, 0.72 * width / part - LEGEND_HEIGHT,
        margins=Margins(bottom=(1.5 if is_paper() else 1.0) * LEGEND_HEIGHT),
        subplot_kw={"projection": "3d", "computed_zorder": False},
    )  # fmt: skip
    drawn_points: list[np.ndarray] = []
    single = len(runs) == 1
    styles = [{"color": COLOURS[0], "lw": 2.0}] if single else make_curve_styles(len(runs))
    for run, style in zip(runs, styles, strict=True):
        poses, colour = select_servoing_poses(run), style["color"]
        path = poses[:, :3, 3]
        drawn_points += [path]
        axis.plot(*path.T, zorder=4, label="camera" if single else escape_math(run.name), **style)
        goal = run.goal_pose
        if np.isfinite(goal).all():
            ideal = np.array([path[0], goal[:3, 3]])
            axis.plot(*ideal.T, color=GOAL if single else colour, lw=1.1, ls="--",
                      zorder=3, label="straight" if single else None)  # fmt: skip
            drawn_points.append(goal[None, :3, 3])
    corners = compute_face_corners(runs[0])
    if len(corners) > 2:
        axis.add_collection3d(Poly3DCollection([corners], facecolor=INK, edgecolor=INK, zorder=1))
    points = np.vstack([*drawn_points, corners])
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(float((high - low).max()), 1e-3)
    length = FRUSTUM_SIZE * size
    for number, (run, style) in enumerate(zip(runs, styles, strict=True)):
        poses, colour = select_servoing_poses(run), style["color"]
        start_colour, goal_colour = (START, GOAL) if single else (colour, INK)
        _draw_camera(axis, poses[0], length, start_colour, "start" if single else None)
        if np.isfinite(run.goal_pose).all():
            _draw_camera(axis, run.goal_pose, GOAL_FRUSTUM_SCALE * length, goal_colour,
                         "goal" if number == 0 else None, "--")  # fmt: skip
        _draw_camera(axis, poses[-1], length, colour, "end" if single else None)
    room = 0.5 * length
    # The axes of a planar path would form a flat box, so each axis has at least a length of
    # MIN_AXIS_RATIO * size.
    padding = np.maximum(0.5 * (MIN_AXIS_RATIO * size - (high - low)), room)
    low, high = low - padding, high + padding
    axis.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)",
             xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))  # fmt: skip
    extent = high - low
    # A tall view is drawn smaller, because it would otherwise overlap the legend below the axes.
    is_tall = extent[2] > MAX_HEIGHT_RATIO * extent[:2].max()
    # zoom of the 3-D view that leaves space for the larger letters of a figure for a paper
    paper_scale = 0.82 if is_paper() else 1.0
    axis.set_box_aspect(extent, zoom=paper_scale * (0.82 if is_tall else 0.97))
    axis.view_init(elev=20, azim=-58)
    for pane in (axis.xaxis, axis.yaxis, axis.zaxis):
        pane.set_pane_color((1.0, 1.0, 1.0, 0.0))
        pane.set_major_locator(plt.MaxNLocator(2 if is_tall and pane is not axis.zaxis else 4))
        pane._axinfo["grid"].update(color=GRID, linewidth=0.6)
    add_legend_below(figure, 5)
    if not is_paper():
        figure.text(0.1 / width, 0.995, "Path of the camera in the world  (dashed: straight to the "
                    "goal)", va="top", fontweight="bold", fontsize=10.5)  # fmt: skip
    return figure


def select_servoing_poses(run: Run) -> np.ndarray:
    """Return the known true poses (m, 4, 4) of the camera during servoing."""
    poses = run.true_pose[run.servoing]
    return poses[np.isfinite(poses).all(axis=(1, 2))]


def compute_face_corners(run: Run) -> np.ndarray:
    """Compute the corners (c, 3) of the target's face in the world at the start of servoing, m.

    c is 0 if the run has no target.
    """
    if run.target is None:
        return np.zeros((0, 3))
    pose = run.target.world_T_target(run.start_stamp)
    return run.target.shape.vertices() @ pose[:3, :3].T + pose[:3, 3]


def _draw_camera(
    axis: Axes, pose: np.ndarray, size: float, colour: str, label: str | None, line: str = "-"
) -> None:
    """Draw a camera at a pose (4, 4) as a pyramid, from the optical centre along the optical axis.
    """
    rim = size * np.array([[-0.4, -0.3, 1.0], [0.4, -0.3, 1.0], [0.4, 0.3, 1.0], [-0.4, 0.3, 1.0]])
    rim = rim * [1.0, 1.0, 0.7] @ pose[:3, :3].T + pose[:3, 3]
    tip = pose[:3, 3]
    axis.plot(*np.vstack([rim, rim[:1]]).T, color=colour, lw=1.0, ls=line, zorder=6, label=label)
    for corner in rim:
        axis.plot(*np.array([tip, corner]).T, color=colour, lw=0.8, ls=line, zorder=6)
