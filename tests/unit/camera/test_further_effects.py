"""Camera effects of the registry and of users: selected by name, reproducible."""

import numpy as np
import pytest

from aras_sim_bridge.camera.config import CameraConfig
from aras_sim_bridge.camera.effects import EFFECTS, Effect, EffectChain, Effects
from aras_sim_bridge.errors import CameraError

IMAGE = np.full((24, 32), 200, np.uint8)
IMAGE[8:16, 10:22] = 20


class Dust(Effect):
    """A user's effect: dark grains at random places."""

    is_random = True
    grains: int = 5
    depth: float = 100.0

    def apply(self, light, random):
        out = light.copy()
        places = random.integers(0, light.size, self.grains)
        out.ravel()[places] = np.maximum(out.ravel()[places] - self.depth, 0)
        return out


OWN = f"{__name__}:Dust"


def read_out(further, stamp=7, seed=3, **others):
    effects = Effects(further=further, **others)
    return EffectChain(effects, IMAGE.shape, seed).apply(IMAGE, stamp)


@pytest.mark.parametrize("name", EFFECTS)
def test_every_registered_effect_changes_the_light_and_nothing_in_place(name):
    before = IMAGE.copy()
    assert (read_out({name: {}}) != IMAGE).any()
    assert (before == IMAGE).all() and EFFECTS[name].__doc__ and EFFECTS.list_parameters(name)


def test_defocus_spreads_an_edge_by_its_standard_deviation_and_keeps_the_light():
    slope = {stddev: np.diff(read_out({"defocus": {"stddev": stddev}})[12, :16].astype(float))
             for stddev in (1.0, 2.0)}  # fmt: skip
    for stddev, step in slope.items():
        assert -step.min() == pytest.approx(180.0 / np.sqrt(2 * np.pi) / stddev, rel=0.06)
    wide = np.full((64, 64), 200, np.uint8)
    wide[28:36, 28:36] = 20
    blurred = EffectChain(Effects(further={"defocus": {"stddev": 2.0}}), wide.shape, 0)
    assert float(blurred.apply(wide, 0).sum()) == pytest.approx(float(wide.sum()), rel=2e-3)


def test_effects_act_on_the_light_in_the_order_given_before_gain_and_noise():
    """Chance depends on seed and stamp alone."""
    one = read_out({OWN: {"grains": 40}, "defocus": {}}, gain=0.5)
    other = read_out({"defocus": {}, OWN: {"grains": 40}}, gain=0.5)
    assert (one != other).any() and one.max() <= 100
    same, *others = (read_out({OWN: {}}, stamp, seed) for stamp, seed in ((7, 3), (8, 3), (7, 4)))
    assert (read_out({OWN: {}}) == same).all() and all((same != one).any() for one in others)


@pytest.mark.parametrize(("further", "words"), [
    ({"defocs": {}}, "unknown effect 'defocs': did you mean 'defocus'"),
    ({"defocus": {"sigma": 1.0}}, "effect 'defocus' takes no 'sigma': .*stddev"),
    ({"defocus": {"stddev": -1.0}}, "effect defocus: stddev is -1.0, must be > 0 px"),
    ({"math:pi": {}}, "not a class derived from Effect"),
    ({"defocus": 2.0}, "effects.further.defocus is 2.0, must be a mapping"),
])
def test_what_is_wrong_is_named(further, words):
    with pytest.raises(CameraError, match=words):
        CameraConfig.from_mapping({"effects": {"further": further}})
