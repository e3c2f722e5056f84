"""gazebo_ros_control's part of a physics step: read, update controllers, write."""

from aras_sim_bridge.control.controllers.base import Controller
from aras_sim_bridge.control.hardware import RobotHardware
from aras_sim_bridge.control.manager import ControllerManager
from aras_sim_bridge.control.stride import Stride, stride_of
from aras_sim_bridge.errors import HardwareError

_NS_PER_S = 1e9


class ControlLoop:
    """Runs hardware and controllers at their periods of simulated time.

    Controllers are updated whenever `control_period` passed since the last update; commands are
    written every physics step. The first period, also the first after reset(), is one step.
    """

    __slots__ = ("hardware", "manager", "_step_ns", "_control_ns", "_updated_ns", "_written_ns",
                 "_stride", "_controllers")

    def __init__(
        self, hardware: RobotHardware, manager: ControllerManager, step_ns: int,
        control_period_ns: int | None = None,
    ) -> None:
        """Raises HardwareError if a period is not positive."""
        self.hardware = hardware
        self.manager = manager
        self._step_ns = step_ns
        self._control_ns = step_ns if control_period_ns is None else control_period_ns
        if self._step_ns <= 0 or self._control_ns <= 0:
            raise HardwareError(
                f"control period {self._control_ns} ns and physics step {step_ns} ns must be "
                f"positive; look at <controlPeriod>"
            )
        self._updated_ns: int | None = None
        self._written_ns: int | None = None
        self._stride: Stride | None = None
        self._controllers: tuple[Controller, ...] = ()

    def reset(self) -> None:
        """Start over with the periods: the next step reads, updates and writes."""
        self._updated_ns = self._written_ns = None
        self.manager.reset()

    def begin_anew(self) -> None:
        """Begin anew, with the joints where they are now: set points stay, nothing else does."""
        self._updated_ns = self._written_ns = None
        self.hardware.start()
        self.manager.reset(anew=True)

    def step(self, time_ns: int) -> None:
        """What is due at `time_ns`, the simulated time the coming physics step ends at."""
        updated_ns = self._updated_ns
        elapsed_ns = self._step_ns if updated_ns is None else time_ns - updated_ns
        if updated_ns is None or elapsed_ns >= self._control_ns:
            period = elapsed_ns / _NS_PER_S
            self.hardware.read(time_ns, period)
            self.manager.update(time_ns, period)
            self._updated_ns = time_ns
        written_ns = self._written_ns
        elapsed_ns = self._step_ns if written_ns is None else time_ns - written_ns
        self.hardware.write(time_ns, elapsed_ns / _NS_PER_S)
        self._written_ns = time_ns

    def begin_stride(self, time_ns: int, step_ns: int) -> tuple[Stride | None, float]:
        """Cycles in a row from `time_ns` on, with a physics step of `step_ns` each, and the time of
        the last one, ns, that may belong to them; None where the next cycle may not."""
        calm_ns = self.manager.calm_until(time_ns)
        in_step = self._updated_ns == self._written_ns == time_ns - step_ns
        if calm_ns < time_ns or not in_step or step_ns < self._control_ns:
            return None, calm_ns
        running = self.manager.running
        if running != self._controllers:
            self._controllers = running
            self._stride = stride_of(running, self.hardware)
        if self._stride is not None:
            for controller in running:
                controller.begin_stride(time_ns)
            self._stride.begin()
        return self._stride, calm_ns

    def end_stride(self, time_ns: int) -> None:
        """The cycles of the stride are over; the last one was at `time_ns`."""
        self._stride.end()
        for controller in self._controllers:
            controller.end_stride(self._stride.made)
        self._updated_ns = self._written_ns = time_ns
