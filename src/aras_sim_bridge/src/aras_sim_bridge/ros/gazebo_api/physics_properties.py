"""Services get/set_physics_properties and the dynamic_reconfigure server of /gazebo.

Only gravity, time step, update rate and solver iterations have an effect, because Bullet has no
counterpart to most parameters of ODE. The other values are stored, so that clients read what they
have written.
"""

from __future__ import annotations

import math

import rospy
from gazebo_msgs.msg import ODEPhysics
from gazebo_msgs.srv import GetPhysicsProperties, SetPhysicsProperties
from geometry_msgs.msg import Vector3

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.ros.conversions import from_vector
from aras_sim_bridge.ros.runtime.reconfigure_parameters import PHYSICS_FIELDS
from aras_sim_bridge.ros.runtime.services import Fields, service_handler
from aras_sim_bridge.ros.runtime.simulation_thread import SimulationThread
from aras_sim_bridge.simulation import Simulation
from aras_visual_servo_ros.parameters import Value
from aras_visual_servo_ros.reconfigure import ReconfigureServer

ODE_FIELDS = tuple(ODEPhysics.__slots__)  # the same names as in dynamic_reconfigure


class PhysicsProperties:
    """Physics properties, which services and dynamic_reconfigure read and set."""

    def __init__(self, namespace: str, thread: SimulationThread) -> None:
        """Start the dynamic_reconfigure server in `namespace`."""
        self._thread = thread
        self._ode: dict[str, Value] = {
            "auto_disable_bodies": False,
            "sor_pgs_precon_iters": 0,
            "sor_pgs_iters": thread.call(lambda: thread.simulation.world.solver_iterations),
            "sor_pgs_w": 1.3,
            "sor_pgs_rms_error_tol": 0.0,
            "contact_surface_layer": 0.001,
            "contact_max_correcting_vel": 100.0,
            "cfm": 0.0,
            "erp": 0.2,
            "max_contacts": 20,
        }
        self._rate = thread.call(lambda: thread.pacer.factor / thread.simulation.world.time_step)
        values = thread.call(self._read_values)
        self._server = ReconfigureServer(namespace, PHYSICS_FIELDS, values, self._reconfigure)

    def _read_values(self) -> dict[str, Value]:
        """Return the current values by their parameter names in dynamic_reconfigure.

        Call this in the simulation thread.
        """
        world = self._thread.simulation.world
        x, y, z = world.gravity
        return {
            "time_step": world.time_step,
            "max_update_rate": self._rate,
            "gravity_x": x,
            "gravity_y": y,
            "gravity_z": z,
            **self._ode,
        }

    @service_handler(GetPhysicsProperties, "got properties")
    def get_physics_properties(
        self, simulation: Simulation, _request: GetPhysicsProperties
    ) -> Fields:
        """Return the current physics properties.

        They include the parameters of ODE, which are stored but have no effect.
        """
        return {
            "time_step": simulation.world.time_step,
            "pause": self._thread.paused,
            "max_update_rate": self._rate,
            "gravity": Vector3(*simulation.world.gravity),
            "ode_config": ODEPhysics(**self._ode),
        }

    @service_handler(SetPhysicsProperties, "physics engine updated", in_caller_thread=True)
    def set_physics_properties(
        self, _thread: SimulationThread, request: SetPhysicsProperties
    ) -> Fields:
        """Set all physics properties."""
        gravity = from_vector(request.gravity, "gravity")
        ode = {name: getattr(request.ode_config, name) for name in ODE_FIELDS}
        # As in gazebo_ros, /gazebo/set_physics_properties does not change sor_pgs_rms_error_tol.
        ode["sor_pgs_rms_error_tol"] = self._ode["sor_pgs_rms_error_tol"]
        values = self._apply(request.time_step, request.max_update_rate, gravity, ode)
        self._server.set_values(values)
        warning = self._thread.call(lambda: _report_stability(self._thread.simulation))
        text = "SetPhysicsProperties: physics engine updated"
        return {"status_message": f"{text}; {warning}"} if warning else None

    def _reconfigure(self, values: dict[str, Value]) -> dict[str, Value]:
        current = self._thread.call(self._read_values)
        if values == current:
            return current
        gravity = (values["gravity_x"], values["gravity_y"], values["gravity_z"])
        ode = {name: values[name] for name in ODE_FIELDS}
        return self._apply(values["time_step"], values["max_update_rate"], gravity, ode)

    def _apply(
        self, time_step: float, rate: float, gravity: tuple[float, ...], ode: dict[str, Value]
    ) -> dict[str, Value]:
        """Change the physics; return the resulting values by their names in dynamic_reconfigure."""
        for name, value in {"max_update_rate": rate, **ode}.items():
            if not math.isfinite(value):
                raise WorldError(f"{name} is {value}; give a finite number")
        for field in PHYSICS_FIELDS:
            # Check integers here, because the messages of the services also allow values that
            # exceed the limits of dynamic_reconfigure.
            if field.type == "int" and not field.minimum <= ode[field.name] <= field.maximum:
                raise WorldError(f"{field.name} is {ode[field.name]}; give a whole number from "
                                 f"{field.minimum} to {field.maximum}")
        if rate < 0:
            raise WorldError(f"max_update_rate is {rate}; give 0 (as fast as possible) or more")

        def job() -> dict[str, Value]:
            simulation = self._thread.simulation
            simulation.set_physics(time_step, gravity, max(int(ode["sor_pgs_iters"]), 1))
            self._thread.pacer.set_factor(rate * time_step, simulation.time_ns)
            self._rate, self._ode = rate, dict(ode)
            if warning := _report_stability(simulation):
                rospy.logwarn("%s", warning)
            return self._read_values()

        return self._thread.call(job)


def _report_stability(simulation: Simulation) -> str:
    """Return warnings for robots whose PIDs are unstable with the current time step."""
    step = simulation.world.time_step
    return "; ".join(
        filter(None, (robot.report_stability(step) for robot in simulation.robots.values()))
    )
