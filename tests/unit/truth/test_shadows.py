"""`light_and_shadows` of tests/truth with fewer rays: shadows of turned boxes by three lights."""

from truth_checks.light import compared


def test_shadows_are_where_rays_say_in_each_light():
    off = list(compared(16))
    assert len(off) == 6
    for name, at_edges, elsewhere in off:
        assert elsewhere < 0.5, name
        assert at_edges < 12.0, name  # of 16 rays
