"""Effects of the camera sensor: calibrated noise, motion blur and rolling shutter."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from scenes import Bench, link_pose, looking

from aras_sim_bridge.camera import CameraConfig, CameraReading, CameraSensor
from aras_sim_bridge.description import RobotDescription, parse_urdf
from aras_sim_bridge.rendering import create_renderer
from aras_sim_bridge.simulation import Simulation, SimulationConfig
from aras_sim_bridge.world import Pose, Twist

from .check import Row, check

_EYE = looking((0.0, 0.0, 0.6), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))


@dataclass(frozen=True)
class _Figures:
    gain: float  # grey levels per electron
    full_well: float  # e-
    read_noise: float  # e-
    dark_current: float  # e-/s
    exposure_time: float  # s


_SENSORS = {
    "large pixels": _Figures(0.007, 32_000.0, 90.0, 30_000.0, 0.01),
    "small pixels": _Figures(0.09, 2_500.0, 12.0, 4_000.0, 0.02),
}


def _pairs(figures: _Figures, exposures: np.ndarray) -> Iterator[tuple[float, float]]:
    """Yield mean and temporal variance of two images of a grey wall at each exposure."""
    with closing(Bench()) as bench:
        bench.box([5.0, 5.0, 0.05], [0, 0, -0.05], "Gazebo/Grey")
        renderer = create_renderer("exact", bench.world)
        for exposure in exposures:
            sensor = CameraSensor(CameraConfig.from_mapping({
                "width": 480, "height": 360, "format": "mono8", "seed": 3,
                "effects": {
                    "exposure": float(exposure), "exposure_samples": 1,
                    "exposure_time": figures.exposure_time, "noise_mean": 8.0,
                    "sensor": {key: getattr(figures, key) for key in (
                        "gain", "full_well", "read_noise", "dark_current")},
                }}), renderer)  # fmt: skip
            one, other = (sensor.capture(link_pose(_EYE), sensor.due_ns).image.astype(float)
                          for _ in range(2))  # fmt: skip
            yield (one + other).mean() / 2.0 - 8.0, (one - other).var() / 2.0


@check("EMVA 1288's photon transfer", quick=True)
def sensor_noise() -> Iterator[Row]:
    """Measure the figures of two sensors from pairs of images, with the method of the standard."""
    for name, figures in _SENSORS.items():
        dark = figures.gain * figures.dark_current * figures.exposure_time
        lit = np.array(list(_pairs(figures, np.linspace(0.02, 1.3, 24))))
        mean, variance = lit.T
        slope, at_zero = np.polyfit(mean, variance - 1.0 / 12.0, 1)
        read = np.sqrt(at_zero) / slope
        ((shaded, _),) = _pairs(figures, np.array([1e-9]))
        ((brightest, _),) = _pairs(figures, np.array([50.0]))
        yield Row(f"{name}, gain", f"{figures.gain:g} grey levels/e-",
                  abs(slope / figures.gain - 1.0), 0.02)  # fmt: skip
        yield Row(f"{name}, read noise", f"{figures.read_noise:g} e-",
                  abs(read / figures.read_noise - 1.0), 0.05)  # fmt: skip
        yield Row(f"{name}, dark signal", f"{dark:.3g} grey levels", abs(shaded - dark), 0.05,
                  "grey levels")  # fmt: skip
        yield Row(f"{name}, full well", f"{figures.full_well:g} e-",
                  abs(brightest / figures.gain / figures.full_well - 1.0), 0.005)  # fmt: skip


_SPEED, _DEEP = 0.8, 0.6  # speed along the rows, m/s; distance from the camera, m
WALL = parse_urdf("""<robot name="wall"><link name="world"><visual><origin xyz="0 0 -0.1"/>
<geometry><box size="6 6 0.1"/></geometry></visual></link></robot>""")


def black_plate(x: float, y: float) -> RobotDescription:
    """A thin black body of these lengths, m."""
    return parse_urdf(f"""<robot name="plate"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><box size="{x} {y} 0.00001"/></geometry></visual></link>
<gazebo reference="base"><material>Gazebo/Black</material></gazebo></robot>""")


def weightless() -> Simulation:
    return Simulation(SimulationConfig(gravity=(0.0, 0.0, 0.0), ground_plane=False))


def _passing(
    effects: dict[str, float],
) -> tuple[np.ndarray, np.ndarray, float, list[CameraReading]]:
    """Take images of a black bar that moves along the rows of a camera."""
    with closing(weightless()) as simulation:
        simulation.spawn(WALL, "wall")
        bar = simulation.spawn(black_plate(0.03, 0.6), "bar", Pose((-0.2, 0.0, 0.0)))
        # The camera looks down, along its +x; +x of the world is to the left in its images.
        camera = simulation.add_camera("watch", {
            "parent": "world", "pose": [0.0, 0.0, _DEEP, np.pi / 2, np.pi / 2, 0.0], "near": 0.02,
            "width": 480, "height": 240, "horizontal_fov": 0.9, "update_rate": 20.0,
            "effects": effects})  # fmt: skip
        frames: list[CameraReading] = []
        camera.on_frame, camera.enabled = frames.append, True
        bar.set_twist(Twist((_SPEED, 0.0, 0.0)))
        while simulation.time_ns < 420_000_000:
            simulation.step(420_000_000)
        seen = camera.parent_T_optical[:3, :3].T @ [1.0, 0.0, 0.0]
        K = camera.sensor.info.K
    per_second = K[0, 0] * seen[0] * _SPEED / _DEEP
    rows = np.arange(240.0)
    return rows, np.full(240, K[0, 2] - 0.2 / _SPEED * per_second), per_second, frames


def _dark(image: np.ndarray) -> np.ndarray:
    """Return the darkness (h, w) of each pixel relative to the grey level of the ground."""
    grey = image[..., 0].astype(float)
    return 1.0 - grey / grey.max()


@check("a bar of known speed", quick=True)
def motion_blur() -> Iterator[Row]:
    """Compare the blur of a bar at 0.8 m/s with its displacement during the exposure."""
    for time in (0.012, 0.03):
        _, _, speed, frames = _passing({"exposure_time": time, "exposure_samples": 16})
        _, _, _, sharp = _passing({})
        way, wrong, off = abs(speed) * time, [], []
        for blurred, still in zip(frames, sharp, strict=True):
            (one, other), columns = (_dark(f.image)[120] for f in (blurred, still)), np.arange(480)
            middle = [(d * columns).sum() / d.sum() for d in (one, other)]
            spread = [(d * (columns - m) ** 2).sum() / d.sum()
                      for d, m in zip((one, other), middle, strict=True)]  # fmt: skip
            wrong.append(np.sqrt(12.0 * (spread[0] - spread[1])) / way - 1.0)
            off.append(middle[0] - middle[1])
        what = f"exposed for {1e3 * time:g} ms"
        yield Row(f"{what}, width", f"{way:.3g} px", abs(float(np.mean(wrong))), 0.01)
        yield Row(f"{what}, middle", "that of the sharp image", float(np.abs(off).max()), 0.02,
                  "px")


@check("a bar of known speed")
def rolling_shutter() -> Iterator[Row]:
    """Compare the skew of a bar at 0.8 m/s with the exposure instants of the rows."""
    for row_time, together in ((5e-5, 1), (1.5e-4, 1), (1.5e-4, 8)):
        rows, begin, speed, frames = _passing({"row_time": row_time, "rows_together": together})
        if len(frames) < 6:
            raise RuntimeError(f"only {len(frames)} pictures")
        errors = []
        for frame in frames:
            dark = _dark(frame.image)
            found = (dark * np.arange(480)).sum(axis=1) / dark.sum(axis=1)
            exposed = 1e-9 * frame.stamp_ns + (rows - 119.5) * row_time
            errors.append(found - (begin + speed * exposed))
        # The instant of a row differs from that of its group by up to half the group.
        allowed = 0.02 + abs(speed) * row_time * 0.5 * (together - 1)
        yield Row(f"row_time {1e6 * row_time:g} µs, {together} rows rendered together",
                  f"displaced by {abs(speed) * row_time * 239:.3g} px",
                  float(np.abs(errors).max()), allowed, "px")  # fmt: skip
