"""In every node `gazebo` that a test starts: whoever touches the simulation from another thread
than its own is named on stderr. ros_graph puts this on the nodes' path and reads the lines.

Slots may be written from anywhere: set_command, set_gains, the emergency stop.
"""

import functools
import os
import sys
import threading
import traceback

TOUCHED = "another thread touched"
SLOTS = {"set_command", "set_gains", "e_stop"}
_inside = threading.local()  # a slot's own assignments are part of it


def watch(owner: threading.Thread) -> None:
    """Watch the classes of the simulation that the thread `owner` will run."""
    from aras_sim_bridge.camera import CameraSensor
    from aras_sim_bridge.camera.mounting import MountedCamera
    from aras_sim_bridge.control.controllers import Controller
    from aras_sim_bridge.control.hardware import RobotHardware
    from aras_sim_bridge.control.loop import ControlLoop
    from aras_sim_bridge.control.manager import ControllerManager
    from aras_sim_bridge.control.pid import Pid
    from aras_sim_bridge.controlled_model import ControlledModel
    from aras_sim_bridge.simulation import Simulation
    from aras_sim_bridge.world import Model, World

    told = set()

    def check(what: str) -> None:
        if threading.current_thread() is owner or getattr(_inside, "slot", False):
            return
        if what in told or not owner.is_alive():
            return
        told.add(what)
        stack = "".join(traceback.format_stack(limit=6)[:-2])
        os.write(2, f"{TOUCHED} {what}:\n{stack}\n".encode())

    def watched(function, what: str, slot: bool):
        @functools.wraps(function)
        def call(*args, **kwargs):
            if not slot:
                check(what)
                return function(*args, **kwargs)
            outer, _inside.slot = getattr(_inside, "slot", False), True
            try:
                return function(*args, **kwargs)
            finally:
                _inside.slot = outer

        return call

    def watch_class(cls: type) -> None:
        for name, value in list(vars(cls).items()):
            if name.startswith("_"):
                continue
            what, slot = f"{cls.__name__}.{name}", name in SLOTS
            if isinstance(value, property):
                parts = (value.fget, value.fset)
                setattr(cls, name, property(*(p and watched(p, what, slot) for p in parts)))
            elif callable(value) and not isinstance(value, type | staticmethod | classmethod):
                setattr(cls, name, watched(value, what, slot))
        plain = cls.__setattr__

        def assign(self, name, value):
            if name not in SLOTS:
                check(f"{cls.__name__}.{name} =")
            plain(self, name, value)

        cls.__setattr__ = assign

    def family(cls: type) -> set:
        bases = {base for base in cls.__mro__ if base.__module__.startswith("aras_")}
        return bases.union(*map(family, cls.__subclasses__()))

    classes = set()
    for cls in (Simulation, ControlledModel, World, Model, RobotHardware, ControllerManager,
                Controller, ControlLoop, Pid, MountedCamera, CameraSensor):  # fmt: skip
        classes |= family(cls)
    # Bases first: what a subclass inherits for assignments is watched once.
    for cls in sorted(classes, key=lambda c: len(c.__mro__)):
        watch_class(cls)


if any(argument.endswith("/gazebo") for argument in sys.orig_argv):
    start = threading.Thread.start

    def watching_start(self) -> None:
        if self.name == "simulation":
            watch(self)
        start(self)

    threading.Thread.start = watching_start
