"""Parameters of the camera node: defaults and errors."""

import pytest

from aras_visual_servo_base.settings import list_defaults
from aras_visual_servo_camera.errors import VisionParameterError
from aras_visual_servo_camera.parameters import VisionParameters


def test_defaults_and_given_values():
    given = list_defaults(VisionParameters)
    assert VisionParameters.from_mapping({}) == VisionParameters.from_mapping(given)
    assert VisionParameters.from_mapping({}).pipeline_settings.original_threshold == 250.0
    parameters = VisionParameters.from_mapping(
        {"layout": "kernel", "threshold": 90, "desired_outline": [0, 0, 1, 0, 1, 1]}
    )
    assert parameters.pipeline_settings.layout == "kernel"
    assert parameters.pipeline_settings.segmentation.threshold == 90.0
    assert parameters.desired_corners == ((0, 0), (1, 0), (1, 1))


@pytest.mark.parametrize(("given", "text"), [
    ({"order": 2}, "~order is 2, must be >= 3"),
    ({"edge_band": 21}, "~edge_band is 21, must be <= 20"),
    ({"original_threshold": 256}, "~original_threshold is 256.0, must be <= 255"),
    ({"segmentation": "nearest_colour"}, "near_colour is .., must be red, green and blue"),
    ({"near_colour": [1, 2, 256]}, "near_colour is .1.0, 2.0, 256.0., must be red"),
    ({"colour_low": [-1, 0, 0]}, "hue 0-179"), ({"colour_high": [180, 0, 0]}, "hue 0-179"),
    ({"colour_high": [0, 256, 0]}, "hue 0-179"), ({"colour_high": [0, 0, 256]}, "hue 0-179"),
    ({"component": "mask"}, "~mask_image must be the path"), ({"colour_low": [1, 2]}, "hue 0-179"),
    ({"desired_outline": [0, 0, 1, 1, 2]}, "at least three corners"),
    ({"adaptive_block": 10}, "must be odd")])
def test_wrong_parameters_are_refused(given, text: str) -> None:
    with pytest.raises(VisionParameterError, match=text):
        VisionParameters.from_mapping(given)
