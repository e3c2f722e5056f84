"""A label image: each pixel's number says which link it shows; some of the links are the target."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from aras_visual_servo_base.names import suggest

from .errors import ImageError, SegmentationError
from .segmented_target import Mask

LINK = "::"  # between the names of model and link


class TargetLabels:
    """Tells the target's pixels in label images.

    Attributes:
        wanted: 'model', of which all links are the target, or 'model::link'.
    """

    def __init__(self, target_name: str) -> None:
        self.target_name = target_name
        self._links: Mapping[int, str] = {}

    @property
    def has_links(self) -> bool:
        """Whether the names of the numbers are known."""
        return bool(self._links)

    def set_links(self, links: Mapping[int, str] | str) -> None:
        """Take in the links, 'model::link', by their numbers; or these as a YAML text.

        Raises:
            SegmentationError: the text is none.
        """
        if isinstance(links, str):
            try:
                links = yaml.safe_load(links)
                links = {int(number): str(link) for number, link in links.items()}
            except (yaml.YAMLError, AttributeError, TypeError, ValueError) as error:
                raise SegmentationError(f"names of labels that cannot be read: {error}") from None
        self._links = links

    def find_target_labels(self) -> list[int]:
        """Those that are the target.

        Raises:
            SegmentationError: no link has that name.
        """
        links = self._links.items()
        found = [n for n, link in links if self.target_name in (link, link.partition(LINK)[0])]
        if not found:
            known = {link for link in self._links.values()}
            known |= {link.partition(LINK)[0] for link in known}
            raise SegmentationError(
                f"segmentation: no link has the label '{self.target_name}': "
                f"{suggest(self.target_name, sorted(known))}"
            )
        return found

    def make_mask(self, labels: NDArray[np.int32]) -> Mask:
        """255 where a label image (rows, columns) has the target, 0 elsewhere; errors as
        `find_target_labels`."""
        return np.isin(labels, self.find_target_labels()).view(np.uint8) * 255


def read_labels(message: Any) -> NDArray[np.int32]:
    """The numbers (rows, columns) of a sensor_msgs/Image of labels, 32SC1.

    Raises:
        ImageError: another encoding, or fewer bytes than the size promises.
    """
    if message.encoding != "32SC1":
        raise ImageError(f"a label image of encoding '{message.encoding}': send 32SC1")
    rows, line = int(message.height), 4 * int(message.width)
    if message.step < line or len(message.data) < message.step * rows:
        raise ImageError(f"label image of {len(message.data)} bytes is too short for its size")
    data = np.frombuffer(message.data, np.uint8)[: message.step * rows]
    data = np.ascontiguousarray(data.reshape(rows, message.step)[:, :line])
    return data.view(">i4" if message.is_bigendian else "<i4").astype(np.int32)
