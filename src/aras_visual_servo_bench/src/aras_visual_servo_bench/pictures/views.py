"""What is seen: the picture plane, a strip of pictures, and the camera's path in space."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from aras_visual_servo_base.poses import exponential, rotation_vector

from ..recording.run import Run
from ..recording.tracks import Tracks, milestones
from ..recording.tracks import tracks as tracks_of
from .over_time import looks
from .palette import COLOURS, FAINT, GOAL, GRID, INK, START
from .style import Margins, figure_width, heading, is_paper, legend_below, literal, panels

FADED = 0.35  # of a picture's contrast behind curves
FLATTEST = 0.35  # least extent of an axis, part of the largest
TALL = 1.5  # of the scene: height over the larger of its other sides
FRUSTUM = 0.12  # length of a drawn camera, part of the scene
BELOW = 0.5  # inches, of the legend below the path in space
AROUND = 1.5  # size of the goal's, that the one at the end does not hide it
EDGE, TITLE, BESIDE = 0.03, 0.3, 0.07  # inches round pictures, above each, between two


def image_trajectory(runs: Sequence[Run]) -> Figure | None:
    """Where the target's points went in the image, over the last picture of the first run."""
    found = [(run, tracks_of(run)) for run in runs]
    found = [(run, tracks) for run, tracks in found if tracks is not None]
    if not found:
        return None
    camera = found[0][0].camera
    width = plt.rcParams["figure.figsize"][0]
    part = 0.66 if is_paper() else 1.0
    figure, (axis,) = panels(1, (width / part - 0.97) * camera.height / camera.width,
                             margins=Margins(0.85, 0.12, 0.36, 0.89))  # fmt: skip
    axis.grid(False)
    for side in axis.spines.values():
        side.set_visible(True)
    pictures = found[0][0].images.pictures
    if pictures and pictures[-1][1].shape[:2] == (camera.height, camera.width):
        axis.imshow((255.0 - FADED * (255.0 - pictures[-1][1])).astype(np.uint8))
    styles = looks(len(found))
    for number, (run, tracks) in enumerate(found):
        _tracks(axis, run, tracks, None if len(found) == 1 else styles[number])
    axis.set(xlabel="column (pixel)", ylabel="row (pixel)", aspect="equal",
             xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5))  # fmt: skip
    if len(found) == 1:
        tracks = found[0][1]
        handles = [
            Line2D([], [], marker="o", ls="", color=START, ms=6, label="start"),
            Line2D([], [], marker="o", ls="", mfc="none", mec=GOAL, mew=1.6, ms=9, label="goal"),
        ]
        if len(tracks.names) <= 6:
            handles = [Line2D([], [], color=_colour(tracks, i), label=literal(name))
                       for i, name in enumerate(tracks.names)] + handles  # fmt: skip
        kind = "points that the scheme sees" if tracks.measured else "target's corners and centre"
        heading(axis, f"Path of the {kind} in the image")
    else:
        handles = [Line2D([], [], label=literal(run.name), **look)
                   for (run, _), look in zip(found, styles, strict=True)]  # fmt: skip
        heading(axis, "Paths of the target in the image")
    legend_below(figure, 5, handles)
    return figure


def _colour(tracks: Tracks, i: int) -> str:
    """The centre is the bold one where corners go with it."""
    if not tracks.measured:
        return COLOURS[0] if tracks.names[i].startswith("centre") else FAINT
    return COLOURS[i % len(COLOURS)]


def _tracks(axis: Axes, run: Run, tracks: Tracks, look: dict[str, object] | None) -> None:
    for i in range(len(tracks.names)):
        pixels = tracks.pixels[:, i]
        known = np.isfinite(pixels).all(axis=1)
        if not known.any():
            continue
        strong = tracks.measured or tracks.names[i].startswith("centre")
        shown = pixels[known]
        weight = {"alpha": 1.0 if strong else 0.8, "zorder": 4 if strong else 3}
        if look is None:
            own = {"color": _colour(tracks, i), "lw": 1.8 if strong else 0.9}
        else:
            own = look if strong else {**look, "lw": 0.5 * look["lw"], "marker": ""}
        axis.plot(*shown.T, **{**own, **weight})
        axis.plot(*shown[0], "o", color=START if look is None else look["color"],
                  ms=6 if strong else 3, zorder=5)  # fmt: skip
        if np.isfinite(tracks.desired[i]).all():
            axis.plot(*tracks.desired[i], "o", mfc="none", mec=GOAL, mew=1.6 if strong else 0.9,
                      ms=9 if strong else 5, zorder=6)  # fmt: skip


def filmstrip(runs: Sequence[Run]) -> Figure | None:
    """Pictures as the error shrinks, each with the outline that is wanted."""
    runs = [r for r in runs if r.images.pictures]
    if not runs:
        return None
    strips = [(r, milestones(r) or [r.images.pictures[0][0]]) for r in runs]
    columns = max(len(stamps) for _, stamps in strips)
    shape = runs[0].images.pictures[0][1].shape
    part = 0.66 if is_paper() else 1.0
    across = (figure_width(wide=True) / part - 2.0 * EDGE - (columns - 1) * BESIDE) / columns
    figure, axes = panels(
        len(runs) * columns, across * shape[0] / shape[1], columns, wide=True,
        margins=Margins(EDGE, EDGE, TITLE, EDGE, TITLE, BESIDE),
    )  # fmt: skip
    for number, (run, stamps) in enumerate(strips):
        row = axes[number * columns : (number + 1) * columns]
        for axis in row[len(stamps) :]:
            axis.set_visible(False)
        wanted = run.wanted_outline()
        for axis, stamp in zip(row, stamps, strict=False):
            axis.imshow(run.images.nearest(stamp))
            axis.set(xticks=[], yticks=[])
            axis.grid(False)
            for side in axis.spines.values():
                side.set(visible=True, color=FAINT, linewidth=0.6)
            if wanted is not None:
                axis.plot(*np.vstack([wanted, wanted[:1]]).T, color=GOAL, lw=1.1)
            axis.set(xlim=(-0.5, shape[1] - 0.5), ylim=(shape[0] - 0.5, -0.5))
            axis.set_title(f"{stamp - run.began:.2f} s", fontweight="normal", loc="center",
                           fontsize=7 if is_paper() else 10, pad=3)  # fmt: skip
        if len(runs) > 1:
            row[0].text(0.03, 0.95, literal(run.name), transform=row[0].transAxes, va="top",
                        fontsize=7 if is_paper() else 10,
                        bbox={"facecolor": "white", "alpha": 0.7, "pad": 0.5, "lw": 0})  # fmt: skip
    return figure


def camera_path(runs: Sequence[Run]) -> Figure | None:
    """The camera's path in the world, and the straight one with it, above the target."""
    runs = [r for r in runs if len(servoed_poses(r))]
    if not runs:
        return None
    width, part = figure_width(), 0.66 if is_paper() else 1.0
    figure, (axis,) = panels(
        1, 0.72 * width / part - BELOW,
        margins=Margins(bottom=(1.5 if is_paper() else 1.0) * BELOW),
        subplot_kw={"projection": "3d", "computed_zorder": False},
    )  # fmt: skip
    shown: list[np.ndarray] = []
    single = len(runs) == 1
    styles = [{"color": COLOURS[0], "lw": 2.0}] if single else looks(len(runs))
    for run, look in zip(runs, styles, strict=True):
        poses, colour = servoed_poses(run), look["color"]
        path = poses[:, :3, 3]
        shown += [path]
        axis.plot(*path.T, zorder=4, label="camera" if single else literal(run.name), **look)
        goal = run.goal_pose
        if np.isfinite(goal).all():
            ideal = straight(poses[0], goal)
            axis.plot(*ideal[:, :3, 3].T, color=GOAL if single else colour, lw=1.1, ls="--",
                      zorder=3, label="straight" if single else None)  # fmt: skip
            shown.append(goal[None, :3, 3])
    target = _target(axis, runs[0])
    points = np.vstack(shown + ([target] if target is not None else []))
    low, high = points.min(axis=0), points.max(axis=0)
    size = max(float((high - low).max()), 1e-3)
    for number, (run, look) in enumerate(zip(runs, styles, strict=True)):
        poses, colour = servoed_poses(run), look["color"]
        _camera(axis, poses[0], FRUSTUM * size, START if single else colour, "start" if single
                else None)  # fmt: skip
        if np.isfinite(run.goal_pose).all():
            _camera(axis, run.goal_pose, AROUND * FRUSTUM * size, GOAL if single else INK,
                    "goal" if number == 0 else None, "--")  # fmt: skip
        _camera(axis, poses[-1], FRUSTUM * size, colour, "end" if single else None)
    room = 0.5 * FRUSTUM * size
    # A path in a plane is not drawn as a line seen from its edge.
    thin = np.maximum(0.5 * (FLATTEST * size - (high - low)), room)
    low, high = low - thin, high + thin
    axis.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)",
             xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))  # fmt: skip
    extent = high - low
    tall = extent[2] > TALL * extent[:2].max()  # its foot would stand in the legend
    small = 0.82 if is_paper() else 1.0  # whose letters are large beside it
    axis.set_box_aspect(extent, zoom=small * (0.82 if tall else 0.97))
    axis.view_init(elev=20, azim=-58)
    for pane in (axis.xaxis, axis.yaxis, axis.zaxis):
        pane.set_pane_color((1.0, 1.0, 1.0, 0.0))
        pane.set_major_locator(plt.MaxNLocator(2 if tall and pane is not axis.zaxis else 4))
        pane._axinfo["grid"].update(color=GRID, linewidth=0.6)
    legend_below(figure, 5)
    if not is_paper():
        figure.text(0.1 / width, 0.995, "Path of the camera in the world  (dashed: straight to the "
                    "goal)", va="top", fontweight="bold", fontsize=10.5)  # fmt: skip
    return figure


def servoed_poses(run: Run) -> np.ndarray:
    """Of the camera while servoing (m, 4, 4), those that are known."""
    poses = run.true_pose[run.servoing]
    return poses[np.isfinite(poses).all(axis=(1, 2))]


def straight(start: np.ndarray, goal: np.ndarray, count: int = 40) -> np.ndarray:
    """Poses (count, 4, 4) on the shortest path: place on a line, attitude about one axis."""
    turn = rotation_vector(start[:3, :3].T @ goal[:3, :3])
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose, part in zip(poses, np.linspace(0.0, 1.0, count), strict=True):
        pose[:3, :3] = start[:3, :3] @ exponential((0.0, 0.0, 0.0, *(part * turn)))[:3, :3]
        pose[:3, 3] = (1.0 - part) * start[:3, 3] + part * goal[:3, 3]
    return poses


def _target(axis: Axes, run: Run) -> np.ndarray | None:
    """The target's face; its corners (c, 3) in the world."""
    if run.target is None:
        return None
    placed = run.target.world_T_target(run.began)
    corners = run.target.shape.vertices() @ placed[:3, :3].T + placed[:3, 3]
    if len(corners) > 2:
        axis.add_collection3d(Poly3DCollection([corners], facecolor=INK, edgecolor=INK, zorder=1))
    return corners


def _camera(axis: Axes, pose: np.ndarray, size: float, colour: str, label: str | None,
            line: str = "-") -> None:  # fmt: skip
    """A frustum: its tip where the camera is, opening along its optical axis."""
    rim = size * np.array([[-0.4, -0.3, 1.0], [0.4, -0.3, 1.0], [0.4, 0.3, 1.0], [-0.4, 0.3, 1.0]])
    rim = rim * [1.0, 1.0, 0.7] @ pose[:3, :3].T + pose[:3, 3]
    tip = pose[:3, 3]
    axis.plot(*np.vstack([rim, rim[:1]]).T, color=colour, lw=1.0, ls=line, zorder=6, label=label)
    for corner in rim:
        axis.plot(*np.array([tip, corner]).T, color=colour, lw=0.8, ls=line, zorder=6)
