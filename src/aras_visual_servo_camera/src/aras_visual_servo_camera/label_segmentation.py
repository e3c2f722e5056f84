"""Label images, in which each pixel contains the number of a link, and the labels of the target."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from aras_visual_servo_base.names import suggest

from .errors import ImageError, SegmentationError
from .segmented_target import Mask

LINK = "::"  # separator in the name 'model::link' of a label


class LabelSegmentation:
    """Finds the target's pixels in label images.

    Attributes:
        target_name: 'model::link' if one link is the target, 'model' if all links of a model are.
    """

    def __init__(self, target_name: str) -> None:
        self.target_name = target_name
        self._links: Mapping[int, str] = {}

    def set_links(self, links: Mapping[int, str] | str) -> None:
        """Set the name 'model::link' of each label, from a mapping or from its YAML text.

        Raises:
            SegmentationError: the text is not a mapping from numbers to names.
        """
        if isinstance(links, str):
            try:
                links = yaml.safe_load(links)
                links = {int(number): str(link) for number, link in links.items()}
            except (yaml.YAMLError, AttributeError, TypeError, ValueError) as error:
                raise SegmentationError(
                    f"the names of the labels cannot be read ({error}); they must be YAML text "
                    "with lines 'number: model::link'"
                ) from None
        self._links = links

    def find_target_labels(self) -> list[int]:
        """Return the numbers of the target's labels.

        Raises:
            SegmentationError: no link has the target's name.
        """
        links = self._links.items()
        found = [n for n, link in links if self.target_name in (link, link.partition(LINK)[0])]
        if not found:
            known = set(self._links.values())
            known |= {link.partition(LINK)[0] for link in known}
            raise SegmentationError(
                f"segmentation: no link has the label '{self.target_name}': "
                f"{suggest(self.target_name, sorted(known))}"
            )
        return found

    def make_mask(self, labels: NDArray[np.int32]) -> Mask:
        """Return the target's mask, 255 where a label image shows the target, 0 elsewhere.

        The mask and the label image have the shape (rows, columns).

        Raises:
            SegmentationError: no link has the target's name.
        """
        return np.isin(labels, self.find_target_labels()).view(np.uint8) * 255


def read_labels(message: Any) -> NDArray[np.int32]:
    """Return the labels (rows, columns) of a sensor_msgs/Image with the encoding 32SC1.

    Raises:
        ImageError: the encoding is not 32SC1, or the data are too short.
    """
    if message.encoding != "32SC1":
        raise ImageError(
            f"the label image has the encoding '{message.encoding}', which is not supported; send "
            "32SC1"
        )
    rows, line = int(message.height), 4 * int(message.width)
    if message.step < line or len(message.data) < message.step * rows:
        raise ImageError(
            f"the label image's data are truncated: {len(message.data)} bytes with a step of "
            f"{message.step} bytes, must be at least {line * rows} bytes with a step of at least "
            f"{line} for {message.width} x {rows} pixels"
        )
    data = np.frombuffer(message.data, np.uint8)[: message.step * rows]
    data = np.ascontiguousarray(data.reshape(rows, message.step)[:, :line])
    return data.view(">i4" if message.is_bigendian else "<i4").astype(np.int32)
