"""get/set_physics_properties and the dynamic_reconfigure server of /gazebo.

Bullet has no counterpart to most of ODE's numbers: gravity, time step, update rate and solver
iterations act, the rest is kept and handed back, so that a client reads what it wrote.
"""

from __future__ import annotations

import math
from typing import Any

from gazebo_msgs.msg import ODEPhysics
from gazebo_msgs.srv import (
    GetPhysicsProperties,
    GetPhysicsPropertiesResponse,
    SetPhysicsProperties,
    SetPhysicsPropertiesResponse,
)
from geometry_msgs.msg import Vector3

from aras_sim_bridge.errors import WorldError
from aras_sim_bridge.ros.conversions import from_vector
from aras_sim_bridge.ros.runtime.reconfigure import PHYSICS_FIELDS, ReconfigureServer
from aras_sim_bridge.ros.runtime.services import ServiceTable

ODE_FIELDS = (
    "auto_disable_bodies",
    "sor_pgs_precon_iters",
    "sor_pgs_iters",
    "sor_pgs_w",
    "sor_pgs_rms_error_tol",
    "contact_surface_layer",
    "contact_max_correcting_vel",
    "cfm",
    "erp",
    "max_contacts",
)


class PhysicsServices:
    """Physics as services and as reconfigurable parameters, always telling the same."""

    def __init__(self, table: ServiceTable, namespace: str, node: Any) -> None:
        """Add the services to `table` and the server to `namespace`; `node` is the GazeboNode."""
        self._thread = node.thread

        def look() -> tuple[int, float]:
            world = self._thread.simulation.world
            return world.solver_iterations, world.time_step

        iterations, time_step = self._thread.call(look)
        self._ode = {
            "auto_disable_bodies": False,
            "sor_pgs_precon_iters": 0,
            "sor_pgs_iters": iterations,
            "sor_pgs_w": 1.3,
            "sor_pgs_rms_error_tol": 0.0,
            "contact_surface_layer": 0.001,
            "contact_max_correcting_vel": 100.0,
            "cfm": 0.0,
            "erp": 0.2,
            "max_contacts": 20,
        }
        self._rate = self._thread.pacer.factor / time_step
        table.add(
            "get_physics_properties",
            GetPhysicsProperties,
            self._get,
            lambda text: GetPhysicsPropertiesResponse(success=False, status_message=text),
        )
        table.add(
            "set_physics_properties",
            SetPhysicsProperties,
            self._set,
            lambda text: SetPhysicsPropertiesResponse(False, text),
        )
        self._server = ReconfigureServer(
            namespace, PHYSICS_FIELDS, self._values(), self._reconfigure
        )

    def _values(self) -> dict[str, Any]:
        """The present configuration under reconfigure's names."""

        def job() -> tuple[float, tuple[float, float, float]]:
            world = self._thread.simulation.world
            return world.time_step, world.gravity

        time_step, gravity = self._thread.call(job)
        return {
            "time_step": time_step,
            "max_update_rate": self._rate,
            "gravity_x": gravity[0],
            "gravity_y": gravity[1],
            "gravity_z": gravity[2],
            **self._ode,
        }

    def _get(self, _request: GetPhysicsProperties) -> GetPhysicsPropertiesResponse:
        values = self._values()
        return GetPhysicsPropertiesResponse(
            time_step=values["time_step"],
            pause=self._thread.paused,
            max_update_rate=values["max_update_rate"],
            gravity=Vector3(values["gravity_x"], values["gravity_y"], values["gravity_z"]),
            ode_config=ODEPhysics(**{name: self._ode[name] for name in ODE_FIELDS}),
            success=True,
            status_message="GetPhysicsProperties: got properties",
        )

    def _set(self, request: SetPhysicsProperties) -> SetPhysicsPropertiesResponse:
        gravity = from_vector(request.gravity, "gravity")
        ode = {name: getattr(request.ode_config, name) for name in ODE_FIELDS}
        ode["sor_pgs_rms_error_tol"] = self._ode["sor_pgs_rms_error_tol"]  # upstream ignores it
        self._apply(request.time_step, request.max_update_rate, gravity, ode)
        self._server.set_values(self._values())
        return SetPhysicsPropertiesResponse(True, "SetPhysicsProperties: physics engine updated")

    def _reconfigure(self, values: dict[str, Any]) -> dict[str, Any]:
        gravity = (values["gravity_x"], values["gravity_y"], values["gravity_z"])
        ode = {name: values[name] for name in ODE_FIELDS}
        if values != self._values():
            self._apply(values["time_step"], values["max_update_rate"], gravity, ode)
        return self._values()

    def _apply(
        self, time_step: float, rate: float, gravity: tuple[float, ...], ode: dict[str, Any]
    ) -> None:
        for name, value in {"max_update_rate": rate, **ode}.items():
            if not math.isfinite(value):
                raise WorldError(f"{name} is {value}; give a finite number")
        if rate < 0:
            raise WorldError(f"max_update_rate is {rate}; give 0 (as fast as it goes) or more")

        def job() -> None:
            simulation = self._thread.simulation
            iterations = max(int(ode["sor_pgs_iters"]), 1)
            simulation.set_physics(time_step, gravity, iterations)
            self._thread.pacer.set_factor(rate * time_step, simulation.time_ns)

        self._thread.call(job)
        self._rate = rate
        self._ode = dict(ode)
