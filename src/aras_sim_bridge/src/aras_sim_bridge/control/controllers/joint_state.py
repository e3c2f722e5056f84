"""Joint state controller, which reads all joints and commands none."""

from collections.abc import Mapping
from math import inf
from typing import Any

from aras_sim_bridge.control.controllers.base import (
    ClaimedResources,
    Controller,
    ControllerContext,
    JointStates,
    read_joint_names,
)
from aras_sim_bridge.control.controllers.registry import register
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.joints import STATE
from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.settings import read

_NS_PER_S = 1_000_000_000


@register("joint_state_controller/JointStateController")
class JointStateController(Controller):
    """Publish positions, velocities and efforts at `publish_rate` in simulated time.

    The joints have the order of the parameter `joints`, or are sorted by name (byte order) if it is
    not set; `extra_joints` follow. The first sample is published in the first control cycle. With a
    `publish_rate` of 0 or less nothing is published.

    As in Gazebo, the stamp of a sample is the end of the next physics step, although the joints are
    measured before that step. With the parameter `true_stamps` the stamp is the time of the
    measurement.
    """

    interface = STATE
    state_kind = "joint_states"
    is_read_only = True

    def __init_subclass__(cls, **options: Any) -> None:
        """Note whether the subclass inherits `update`, which only reads the joints."""
        super().__init_subclass__(**options)
        cls.is_read_only = cls.update is __class__.update

    def init(
        self, hardware: RobotHardware, parameters: Mapping, context: ControllerContext
    ) -> None:
        """Read the parameters.

        Raises:
            ControllerError: `publish_rate` is missing, or `joints` contains an unknown joint.
        """
        super().init(hardware, parameters, context)
        where = context.where
        rate = read(parameters, "publish_rate", float, where, ControllerError)
        self._rate = rate
        self.true_stamps = read(parameters, "true_stamps", bool, where, ControllerError, False)
        self._step_ns = _NS_PER_S / rate if rate > 0.0 else 0.0
        if "joints" in parameters:
            names = list(read_joint_names(parameters, "joints", where))
        else:
            # This order is that of ros_controllers, which sorts the UTF-8 bytes of the names.
            names = sorted(hardware.interfaces[STATE])
        known = list(hardware.handles)
        self._order = [known.index(self.take_handle(hardware, name).name) for name in names]
        self._rows = hardware.handle_rows
        extras = _read_extra_joints(parameters, where, set(names))
        self.names = (*names, *(name for name, *_ in extras))
        self._extra = tuple([e[k] for e in extras] for k in (1, 2, 3))
        self._start_ns: float | None = None
        self._periods, self._due_ns = 0, inf

    @property
    def claimed_resources(self) -> tuple[ClaimedResources, ...]:
        """The joint state interface with no joints, because reading a joint does not claim it."""
        return (ClaimedResources(f"hardware_interface::{self.interface}", ()),)

    def starting(self, time_ns: int) -> None:
        """Make the first cycle publish a sample; a later start does not change the sampling times.
        """
        super().starting(time_ns)
        if self._start_ns is None:
            self._start_ns = time_ns - 1.001 * self._step_ns
            self.count_samples(0)

    def idle_until(self, time_ns: int) -> float:
        """Return the time of the next sample."""
        if not self.is_read_only:
            return -inf
        if self._rate <= 0.0:
            return inf
        due_ns = self._due_ns
        return due_ns if due_ns - time_ns <= 2.0 * self._step_ns else -inf

    def update(self, time_ns: int, period: float) -> None:
        """Publish a sample if one is due."""
        if self._rate <= 0.0:
            return
        due_ns = self._due_ns
        if due_ns >= time_ns:
            if due_ns - time_ns <= 2.0 * self._step_ns:
                return
            # The clock was reset: publish now instead of waiting for the due time from before the
            # reset.
            self._start_ns = time_ns - 1.001 * self._step_ns
            self._periods = 0
        self.count_samples(1)
        listener = self.on_state
        if listener is not None:
            listener(self.sample_joints(time_ns))

    def list_due_cycles(self, time_ns: int, until_ns: int, step_ns: int) -> list[int]:
        """Return the times, ns, of the control cycles in which a sample is due.

        The cycles follow each other every `step_ns` from `time_ns` to `until_ns`.
        """
        found: list[int] = []
        due_ns = self._due_ns
        while (tick_ns := max(find_next_cycle(due_ns, time_ns, step_ns), time_ns)) <= until_ns:
            found.append(tick_ns)
            due_ns = self._start_ns + (self._periods + 1 + len(found)) * self._step_ns
            time_ns = tick_ns + step_ns
        return found

    def count_samples(self, count: int) -> None:
        """Record that `count` samples were published without calling `update`."""
        self._periods += count
        # Multiply the period instead of adding periods, so that rounding errors do not accumulate.
        self._due_ns = self._start_ns + (self._periods + 1) * self._step_ns

    def sample_joints(self, time_ns: int) -> JointStates:
        """Return the current states of all joints."""
        measured = self._rows[self._order].T.tolist()
        positions, velocities, efforts = self._extra
        return JointStates(
            time_ns,
            self.names,
            measured[0] + positions,
            measured[1] + velocities,
            measured[2] + efforts,
        )


def find_next_cycle(due_ns: float, time_ns: int, step_ns: int) -> int:
    """Return the first time after `due_ns` among time_ns + k step_ns, where k is any integer."""
    return time_ns + (int(due_ns - time_ns) // step_ns + 1) * step_ns


def _read_extra_joints(
    parameters: Mapping, where: str, joint_names: set[str]
) -> list[tuple[str, float, float, float]]:
    """Return the parameter extra_joints as tuples (name, position, velocity, effort).

    Entries whose name is in `joint_names` are left out.
    """
    entries = parameters.get("extra_joints", [])
    if not isinstance(entries, list | tuple):
        raise ControllerError(f"parameter {where}/extra_joints must be a list, found {entries!r}")
    extras = []
    for k, entry in enumerate(entries):
        place = f"{where}/extra_joints[{k}]"
        if not isinstance(entry, Mapping):
            raise ControllerError(f"parameter {place} must have a name, found {entry!r}")
        name = read(entry, "name", str, place, ControllerError)
        values = []
        for key in ("position", "velocity", "effort"):
            value = entry.get(key, 0.0)
            if not isinstance(value, float):
                raise ControllerError(
                    f"parameter {place}/{key} must be a double, found {value!r}; write 0.0, not 0"
                )
            values.append(read(entry, key, float, place, ControllerError, 0.0))
        if name not in joint_names:
            joint_names.add(name)
            extras.append((name, *values))
    return extras
