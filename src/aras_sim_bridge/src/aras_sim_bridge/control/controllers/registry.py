"""Registry of controller types, which finds the class of the parameter <controller>/type.

A user's class can be named in two ways:
- as the type: `type: my_package.my_module:MyController`;
- in the parameter `controller_classes` of the robot's namespace, under a type name of the user's
  choice:
  `controller_classes: {my_package/MyController: my_package.my_module:MyController}`.
"""

import importlib
import sys
from collections.abc import Callable, Mapping
from types import ModuleType

from aras_sim_bridge.control.controllers.base import Controller
from aras_sim_bridge.errors import ControllerError
from aras_visual_servo_base.names import check_subclass, describe_unknown, import_object
from aras_visual_servo_base.registry import Registry

KIND = "controller type"
BASE_CLASS = "controller_interface::ControllerBase"
BUILT_IN = Registry(
    KIND, __package__, (Controller,), ControllerError,
    first=("forward", "joint_state", "pid_controllers"),
)  # fmt: skip


def register(type_name: str, **attributes: str) -> Callable[[type[Controller]], type[Controller]]:
    """Return a class decorator that registers a class as `type_name`.

    `attributes` are class attributes of the registered type. The same class can be registered under
    several names with different attributes, such as `interface`.

    Raises:
        ControllerError: another class is already registered under this name.
    """

    def decorate(cls: type[Controller]) -> type[Controller]:
        named = {"__module__": cls.__module__, "__qualname__": cls.__qualname__, **attributes}
        BUILT_IN.register(type_name)(type(cls.__name__, (cls,), named))
        return cls

    return decorate


class ControllerTypes:
    """Types that one controller manager can load: the built-in ones and users' classes."""

    def __init__(self) -> None:
        self._imported: set[str] = set()
        self._reload: set[str] = set()

    def list_types(self, extra: Mapping | None = None) -> list[str]:
        """Return all type names, sorted; `extra` is the parameter controller_classes."""
        return sorted({*BUILT_IN, *(extra or {})})

    def find(self, type_name: str, extra: Mapping | None = None) -> type[Controller]:
        """Return the class of `type_name`.

        Raises:
            ControllerError: the type is unknown (the message suggests similar names), or its
                module or class cannot be imported or is not a Controller.
        """
        path = (extra or {}).get(type_name)
        if path is None and ":" in type_name:
            path = type_name
        if path is not None:
            return self._import(type_name, path)
        if type_name in BUILT_IN:
            return BUILT_IN[type_name]
        raise ControllerError(
            f"{describe_unknown(KIND, type_name, self.list_types(extra))}. Name your own class in "
            "controller_classes as 'package.module:Class'"
        )

    def _import(self, type_name: str, path: object) -> type[Controller]:
        found = import_object(KIND, type_name, ControllerError, path, self._load)
        return check_subclass(KIND, type_name, found, (Controller,), ControllerError)

    def _load(self, module_name: str) -> ModuleType:
        if module_name in self._reload and module_name in sys.modules:
            module = importlib.reload(sys.modules[module_name])
        else:
            module = importlib.import_module(module_name)
        self._reload.discard(module_name)
        self._imported.add(module_name)
        return module

    def reload(self, extra: Mapping | None = None) -> None:
        """Reload the module of each user's class when the class is used next."""
        named = {str(path).partition(":")[0] for path in (extra or {}).values()}
        self._reload = named | self._imported
