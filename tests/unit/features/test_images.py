"""Image and label messages of every encoding, and invalid ones."""

import numpy as np
import pytest

from aras_visual_servo_camera.errors import ImageError, SegmentationError
from aras_visual_servo_camera.images import ENCODINGS, decode
from aras_visual_servo_camera.label_segmentation import LabelSegmentation, read_labels

messages = pytest.importorskip("sensor_msgs.msg")

RED, GREEN, BLUE = 200, 100, 40
GREY = round(0.299 * RED + 0.587 * GREEN + 0.114 * BLUE)


def message(pixels: np.ndarray, encoding: str, padding: int = 0, big: bool = False):
    rows, columns = pixels.shape[:2]
    lines = np.frombuffer(pixels.tobytes(), np.uint8).reshape(rows, -1)
    lines = np.pad(lines, ((0, 0), (0, padding)), constant_values=0xEE)
    return messages.Image(height=rows, width=columns, encoding=encoding, step=lines.shape[1],
                          data=lines.tobytes(), is_bigendian=big)


def coloured(encoding: str) -> np.ndarray:
    """Return an image (8, 10) of one colour, as the encoding stores it."""
    channels = {"r": RED, "g": GREEN, "b": BLUE, "a": 255}
    if encoding.startswith("bayer"):
        pattern = [channels[c] for c in encoding[6:10]]
        return np.tile(np.array(pattern, np.uint8).reshape(2, 2), (4, 5))
    if encoding == "mono8":
        return np.full((8, 10), GREY, np.uint8)
    if encoding == "mono16":
        return np.full((8, 10), GREY * 256 + 77, np.uint16)
    one = np.array([channels[c] for c in encoding.rstrip("0123456789")])
    if encoding.endswith("16"):
        return np.tile(one.astype(np.uint16) * 256 + 77, (8, 10, 1))
    return np.tile(one.astype(np.uint8), (8, 10, 1))


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("padding", [0, 6])
def test_every_encoding_gives_its_grey_and_colour(encoding: str, padding: int) -> None:
    image = decode(message(coloured(encoding), encoding, padding))
    assert image.shape == (8, 10)
    assert image.grey.shape == (8, 10) and image.grey.dtype == np.uint8
    assert abs(int(image.grey[4, 5]) - GREY) <= 1
    assert image.rgb.shape == (8, 10, 3)
    expected = (RED, GREEN, BLUE) if image.has_colour else (GREY,) * 3
    np.testing.assert_allclose(image.rgb[4, 5], expected, atol=1)


@pytest.mark.parametrize("encoding", ["mono16", "rgb16"])
def test_both_byte_orders(encoding: str) -> None:
    pixels = coloured(encoding)
    little = decode(message(pixels, encoding))
    big = decode(message(pixels.byteswap(), encoding, big=True))
    np.testing.assert_array_equal(little.grey, big.grey)


@pytest.mark.parametrize(("changes", "text"), [
    ({"encoding": "8UC3"}, "encoding '8UC3' is not supported; send one of mono8"),
    ({"data": b"\0" * 60}, "truncated: 60 bytes, must be 72 for 4 rows"),
    ({"step": 17}, "step is 17, must be at least 18"), ({"step": 0}, "step is 0, must"),
    ({"width": 0}, "its size is 0 x 4 pixels"), ({"height": 0}, "empty")])
def test_broken_messages_are_refused(changes, text: str) -> None:
    good = {"height": 4, "width": 6, "encoding": "rgb8", "step": 18, "data": bytes(72)}
    with pytest.raises(ImageError, match=text):
        decode(messages.Image(**{**good, **changes}))


NAMES = "1: ground::link\n2: cart::cart\n16777218: cart::wheel\n33554434: cart::box\n"
NUMBERS = np.array([[1, 2, 16777218], [-1, 33554434, 2]], np.int32)


@pytest.mark.parametrize(("wanted", "pixels"), [("cart", [[0, 255, 255], [0, 255, 255]]),
                                                ("cart::wheel", [[0, 0, 255], [0, 0, 0]]),
                                                ("ground", [[255, 0, 0], [0, 0, 0]])])  # fmt: skip
def test_a_model_or_one_of_its_links_is_told(wanted, pixels):
    labels = LabelSegmentation(wanted)
    labels.set_links(NAMES)
    assert labels.make_mask(NUMBERS).tolist() == pixels


def test_a_name_that_there_is_not_is_said_with_the_nearest():
    labels = LabelSegmentation("cart::whel")
    labels.set_links(NAMES)
    with pytest.raises(SegmentationError, match="did you mean 'cart::wheel'"):
        labels.make_mask(NUMBERS)
    with pytest.raises(SegmentationError, match="cannot be read"):
        labels.set_links("a, b")


@pytest.mark.parametrize(("order", "kind"), [(0, "<i4"), (1, ">i4")])
def test_a_message_is_read_with_its_padding_and_byte_order(order, kind):
    sent = message(NUMBERS.astype(kind), "32SC1", 8, order)
    assert read_labels(sent).tolist() == NUMBERS.tolist()
    sent.data = sent.data[:-1]
    with pytest.raises(ImageError, match="truncated"):
        read_labels(sent)
    sent.encoding = "mono8"
    with pytest.raises(ImageError, match="send 32SC1"):
        read_labels(sent)
