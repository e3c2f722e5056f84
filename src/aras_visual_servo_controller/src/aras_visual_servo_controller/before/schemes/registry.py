"""Schemes by name."""

import importlib

from ...desired import Desired
from ...errors import ConfigurationError
from ..laws import Law
from .base import Scheme

SCHEMES = {
    "moments": "aras_visual_servo_controller.before.schemes.moments:MomentsScheme",
    "moments_2016": "aras_visual_servo_controller.before.schemes.moments:Moments2016Scheme",
    "kernel": "aras_visual_servo_controller.before.schemes.kernel:KernelScheme",
}


def find(name: str) -> type[Scheme]:
    """The class of that short name or 'package.module:Class'.

    Raises:
        ConfigurationError: no such name, module or class, or the class is not a Scheme.
    """
    place = SCHEMES.get(name, name)
    module_name, colon, class_name = place.partition(":")
    if not (module_name and colon and class_name):
        raise ConfigurationError(
            f"scheme '{name}' is unknown: use {', '.join(SCHEMES)} or 'package.module:Class'"
        )
    try:
        found = getattr(importlib.import_module(module_name), class_name, None)
    except ImportError as error:
        raise ConfigurationError(
            f"scheme '{name}': cannot import {module_name} ({error}); is its package built and "
            "its workspace sourced?"
        ) from error
    if not (isinstance(found, type) and issubclass(found, Scheme)):
        raise ConfigurationError(
            f"scheme '{name}': {module_name} has no class {class_name} derived from "
            "aras_visual_servo_controller.before.schemes.Scheme"
        )
    return found


def create(name: str, desired: Desired, law: Law) -> Scheme:
    """Construct the scheme of that name; see `find`."""
    return find(name)(desired, law)
