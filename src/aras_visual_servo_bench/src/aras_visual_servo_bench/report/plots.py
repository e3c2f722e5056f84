"""The five plots of a run. One look for all: SI units, time from the first servoed image."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..targets import ARAS
from .recording import Recording

# Okabe and Ito's palette: told apart by colour-blind readers too.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
START, GOAL = "#d55e00", "#009e73"
STYLE = {
    "figure.dpi": 110,
    "savefig.dpi": 150,
    "figure.constrained_layout.use": True,
    "figure.facecolor": "white",
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "lines.linewidth": 1.7,
    "legend.frameon": False,
    "axes.prop_cycle": matplotlib.cycler(color=COLOURS),
}
WORDS = {
    "xn": "$x_n$ (m)",
    "yn": "$y_n$ (m)",
    "an": "$a_n$ (m)",
    "alpha": r"$\alpha$ (rad)",
    "kernel_0": "kernel 0 (rows, relative)",
    "kernel_1": "kernel 1 (columns, relative)",
    "kernel_2": "kernel 2 (area, relative)",
    "kernel_3": "kernel 3 (angle, rad)",
}


def write_all(
    run: Recording,
    goal_pose: np.ndarray,
    goal_centre: np.ndarray,
    directory: Path,
    thresholds: Sequence[float] = (),
    settling: float | None = None,
) -> list[Path]:
    """Draw every plot into a directory.

    Args:
        run: what was recorded.
        goal_pose: `base_T_optical` (4, 4) that was to be reached.
        goal_centre: (2,) normalised centre of gravity of the target there.
        directory: existing; files of the same names are overwritten.
        thresholds: of the features' errors, drawn as a band.
        settling: s, marked in the error plot.

    Returns:
        The files.
    """
    drawings = {
        "feature_errors.png": lambda: feature_errors(run, thresholds, settling),
        "camera_twist.png": lambda: camera_twist(run),
        "joint_positions.png": lambda: joint_positions(run),
        "camera_path.png": lambda: camera_path(run, goal_pose),
        "image_trajectory.png": lambda: image_trajectory(run, goal_centre),
    }
    written = []
    with plt.rc_context(STYLE):
        for name, draw in drawings.items():
            figure = draw()
            path = directory / name
            figure.savefig(path)
            plt.close(figure)
            written.append(path)
    return written


def feature_errors(
    run: Recording, thresholds: Sequence[float] = (), settling: float | None = None
) -> Figure:
    """Error of every feature over time, a panel each, and their norm."""
    states = run.states
    time = states.stamp - run.began
    count = len(states.names)
    figure, axes = plt.subplots(count + 1, 1, sharex=True, figsize=(7.5, 1.5 * (count + 1) + 0.6))
    for index, (axis, name) in enumerate(zip(axes, states.names, strict=False)):
        if index < len(thresholds):
            bound = thresholds[index]
            axis.axhspan(-bound, bound, color="#009e73", alpha=0.15, lw=0)
        axis.axhline(0.0, color="#999999", lw=0.8)
        axis.plot(time, states.error[:, index], color=COLOURS[index % len(COLOURS)])
        axis.set_ylabel(WORDS.get(name, name))
    norm = np.linalg.norm(states.error, axis=1)
    axes[-1].semilogy(time, np.maximum(norm / norm[0], 1e-6), color="#333333")
    axes[-1].axhline(0.02, color="#009e73", ls="--", lw=1.0)
    axes[-1].set_ylabel("norm, relative")
    axes[-1].annotate(
        "2 %", (time[-1], 0.02), xytext=(-2, 3), textcoords="offset points", ha="right",
        color="#009e73",
    )
    if settling is not None:
        axes[-1].axvline(settling, color="#009e73", ls=":", lw=1.2)
        axes[-1].annotate(
            f"settled after {settling:.2f} s", (settling, 0.5), xytext=(5, 0),
            textcoords="offset points", color="#009e73",
        )
    axes[-1].set_xlabel("time since servoing began (s)")
    band = " (band: counts as reached)" if len(thresholds) else ""
    axes[0].set_title(f"Feature errors s − s*{band}")
    _limits(axes[-1], time)
    figure.align_ylabels(axes)
    return figure


def camera_twist(run: Recording) -> Figure:
    """Twist asked of the camera: linear above, angular below."""
    time = run.states.stamp - run.began
    figure, (linear, angular) = plt.subplots(2, 1, sharex=True, figsize=(7.5, 5.2))
    for axis, columns, symbol, unit in (
        (linear, range(3), "v", "m/s"),
        (angular, range(3, 6), r"\omega", "rad/s"),
    ):
        for index, column in enumerate(columns):
            axis.plot(time, run.states.twist[:, column], label=f"${symbol}_{'xyz'[index]}$")
        axis.axhline(0.0, color="#999999", lw=0.8, zorder=1)
        axis.set_ylabel(f"${symbol}$ ({unit})")
        _legend(axis)
    linear.set_title("Twist asked of the camera, in its optical frame")
    angular.set_xlabel("time since servoing began (s)")
    _limits(angular, time)
    figure.align_ylabels([linear, angular])
    return figure


def joint_positions(run: Recording) -> Figure:
    """Measured joints with their commands, a panel each."""
    time = run.joint_stamp - run.began
    commanded = run.states.stamp - run.began
    names = run.states.joint_names
    rows = -(-len(names) // 2)
    figure, axes = plt.subplots(rows, 2, sharex=True, figsize=(9.0, 0.4 + 2.0 * rows))
    for index, (axis, name) in enumerate(zip(axes.T.flat, names, strict=False)):
        shown = (time >= -0.3) & (time <= commanded[-1] + 0.1)
        axis.plot(time[shown], run.joints[shown, index], color=COLOURS[0], label="measured")
        axis.plot(
            commanded, run.states.commands[:, index], color=COLOURS[1], lw=1.1, ls="--",
            label="command",
        )
        axis.set_ylabel(f"{name} ({'m' if name == 'gantry' else 'rad'})")
        low, high = axis.get_ylim()
        if high - low < 0.01:  # a joint that stands still shall look like one
            middle = 0.5 * (low + high)
            axis.set_ylim(middle - 0.005, middle + 0.005)
    for axis in axes[-1]:
        axis.set_xlabel("time since servoing began (s)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2)
    figure.suptitle("Joint positions", x=0.01, ha="left", fontweight="bold", fontsize=11)
    figure.align_ylabels(axes)
    return figure


def camera_path(run: Recording, goal_pose: np.ndarray) -> Figure:
    """Path of the camera over the target, in the base frame."""
    servoing = run.camera_stamp >= run.began
    path = run.camera_pose[servoing][:, :3, 3]
    goal = goal_pose[:3, 3]
    figure = plt.figure(figsize=(7.5, 6.2))
    axis = figure.add_subplot(projection="3d", computed_zorder=False)
    plates = ARAS.geometry.boxes
    surface = ARAS.geometry.surface
    for low, high in plates:
        xs = [low[0], high[0], high[0], low[0], low[0]]
        ys = [low[1], low[1], high[1], high[1], low[1]]
        axis.plot_surface(
            np.array([[low[0], high[0]]] * 2), np.array([[low[1]] * 2, [high[1]] * 2]),
            np.full((2, 2), surface), color="#333333", shade=False, zorder=1,
        )
        axis.plot(xs, ys, surface, color="#333333", lw=0.8, zorder=1)
    axis.plot(*path[:, :2].T, surface, color="#bbbbbb", lw=1.2, zorder=2, label="its shadow")
    for point, colour in ((path[0], START), (path[-1], COLOURS[0])):
        axis.plot(*np.array([point, [*point[:2], surface]]).T, color=colour, lw=0.8, ls=":",
                  zorder=2)
    axis.plot(*path.T, color=COLOURS[0], lw=2.2, zorder=4, label="camera")
    axis.scatter(*path[0], color=START, s=45, zorder=5, depthshade=False, label="start")
    axis.scatter(*goal, facecolors="none", edgecolors=GOAL, s=130, lw=2.0, zorder=6,
                 depthshade=False, label="goal")
    axis.scatter(*path[-1], color=COLOURS[0], s=25, zorder=7, depthshade=False, label="end")
    axis.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
    corners = np.vstack([path, [goal], [p for plate in plates for p in plate]])
    low, high = corners.min(axis=0) - 0.01, corners.max(axis=0) + 0.01
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(surface - 0.005, high[2]))
    axis.set_box_aspect((high[0] - low[0], high[1] - low[1], high[2] - surface), zoom=0.9)
    axis.view_init(elev=22, azim=-58)
    for pane in (axis.xaxis, axis.yaxis, axis.zaxis):
        pane.set_pane_color((1.0, 1.0, 1.0, 0.0))
        pane.set_major_locator(plt.MaxNLocator(5))
    figure.legend(loc="outside lower center", ncols=5)
    figure.suptitle("Path of the camera above the target, base frame", x=0.01, ha="left",
                    fontweight="bold", fontsize=11)
    return figure


def image_trajectory(run: Recording, goal_centre: np.ndarray) -> Figure:
    """Where the target's centre of gravity went in the image, over the last image."""
    servoing = run.moments.stamp >= run.began
    m = run.moments.m[servoing]
    time = run.moments.stamp[servoing] - run.began
    camera = run.images.camera
    pixels = np.column_stack(camera.project(m[:, 1] / m[:, 0], m[:, 2] / m[:, 0]))
    goal = np.ravel(camera.project(*np.reshape(goal_centre, (2, 1))))

    figure, axis = plt.subplots(figsize=(7.5, 5.4))
    axis.grid(False)
    if run.images.last is not None:
        # Faded, so that the curve stands out.
        axis.imshow((255.0 - 0.35 * (255.0 - run.images.last)).astype(np.uint8))
    axis.plot(*pixels.T, color="#777777", lw=1.0, zorder=2)
    dots = axis.scatter(*pixels.T, c=time, cmap="viridis", s=14, zorder=3)
    axis.scatter(*pixels[0], color=START, s=60, zorder=4, label="start")
    axis.scatter(*goal, marker="o", facecolors="none", edgecolors=GOAL, s=150, lw=2.0, zorder=5,
                 label="goal")
    axis.set(xlabel="column (pixel)", ylabel="row (pixel)")
    if run.images.last is not None:
        height, width = run.images.last.shape[:2]
        axis.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5))
    axis.set_aspect("equal")
    figure.colorbar(dots, ax=axis, label="time since servoing began (s)", shrink=0.85)
    figure.legend(loc="outside lower center", ncols=2)
    axis.set_title("Centre of the target in the image (behind it: the last image)")
    return figure


def _limits(axis: Axes, time: np.ndarray) -> None:
    axis.set_xlim(0.0, max(float(time[-1]), 1e-3))


def _legend(axis: Axes) -> None:
    """Beside the data, never over it."""
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def write_images(run: Recording, directory: Path) -> list[Path]:
    """first.png and last.png: what the camera saw when servoing began and at the end."""
    written = []
    for name, image in (("first.png", run.images.first), ("last.png", run.images.last)):
        if image is not None:
            plt.imsave(directory / name, image)
            written.append(directory / name)
    return written
