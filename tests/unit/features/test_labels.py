"""Label images: the labels of the target, and transport on a graph."""

import numpy as np
import pytest

from aras_visual_servo_camera.errors import ImageError, SegmentationError
from aras_visual_servo_camera.labels import TargetLabels, read_labels

messages = pytest.importorskip("sensor_msgs.msg")

NAMES = "1: ground::link\n2: cart::cart\n16777218: cart::wheel\n33554434: cart::box\n"
NUMBERS = np.array([[1, 2, 16777218], [-1, 33554434, 2]], np.int32)


@pytest.mark.parametrize(("wanted", "pixels"), [
    ("cart", [[0, 255, 255], [0, 255, 255]]),
    ("cart::wheel", [[0, 0, 255], [0, 0, 0]]),
    ("ground", [[255, 0, 0], [0, 0, 0]]),
])  # fmt: skip
def test_a_model_or_one_of_its_links_is_told(wanted, pixels):
    labels = TargetLabels(wanted)
    assert not labels.has_links
    labels.set_links(NAMES)
    assert labels.has_links
    assert labels.make_mask(NUMBERS).tolist() == pixels


def test_a_name_that_there_is_not_is_said_with_the_nearest():
    labels = TargetLabels("cart::whel")
    labels.set_links(NAMES)
    with pytest.raises(SegmentationError, match="did you mean 'cart::wheel'"):
        labels.make_mask(NUMBERS)
    with pytest.raises(SegmentationError, match="cannot be read"):
        labels.set_links("a, b")


@pytest.mark.parametrize(("order", "kind"), [(0, "<i4"), (1, ">i4")])
def test_a_message_is_read_with_its_padding_and_byte_order(order, kind):
    rows = np.zeros((2, 20), np.uint8)
    rows[:, :12] = NUMBERS.astype(kind).view(np.uint8)
    message = messages.Image(
        encoding="32SC1", height=2, width=3, step=20, is_bigendian=order, data=rows.tobytes())
    assert read_labels(message).tolist() == NUMBERS.tolist()
    message.data = message.data[:-1]
    with pytest.raises(ImageError, match="truncated"):
        read_labels(message)
    message.encoding = "mono8"
    with pytest.raises(ImageError, match="send 32SC1"):
        read_labels(message)
