"""Principal axes of inertia tensors; impossible tensors are refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aras_sim_bridge.description.inertia import inertia_tensor, make_inertial
from aras_sim_bridge.errors import DescriptionError
from aras_sim_bridge.world.bullet_files import find_principal_frame
from aras_visual_servo_base.poses import rotate


def tensors():
    """Symmetric positive tensors whose eigenvectors come out of numpy as reflections and not."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        moments = np.array([1.0, 1.5, 2.0]) * rng.uniform(0.5, 2)
        R = Rotation.from_euler("xyz", rng.uniform(-3, 3, 3)).as_matrix()
        T = R @ np.diag(moments) @ R.T
        yield T[0, 0], T[0, 1], T[0, 2], T[1, 1], T[1, 2], T[2, 2]


def test_what_bullet_gets_is_the_same_tensor_about_the_same_point():
    rpy = (0.3, -0.2, 0.9)
    for inertia in tensors():
        inertial = make_inertial("link 'a'", 2.0, (1.0, 2.0, 3.0), rpy, inertia, [])
        pose, moments = find_principal_frame(inertial)
        assert pose.xyz == (1.0, 2.0, 3.0)
        R = np.array([rotate(pose.quat, tuple(axis)) for axis in np.eye(3)]).T
        frame = Rotation.from_euler("xyz", rpy).as_matrix()
        np.testing.assert_allclose(R @ np.diag(moments) @ R.T,
                                   frame @ inertia_tensor(inertia) @ frame.T, atol=1e-12)


def make(*tensor, mass=1.0):
    warnings = []
    return make_inertial("link 'a'", mass, (0, 0, 0), (0, 0, 0), tensor, warnings), warnings


@pytest.mark.parametrize("scale", [1e-3, 1e4])
@pytest.mark.parametrize(("moments", "complaint"), [
    ((1.0, 1.0, -1e-9), ""), ((1.0, 1.0, -1.1e-9), "negative principal moment"),
    ((1.0, 2.0, 3.0), ""), ((3.0059, 1.0, 2.0), ""),  # 0.001 of the trace: a CAD export's rounding
    ((2.0, 1.0, 3.0062), "break the triangle inequality"),
])
def test_how_much_a_tensor_may_be_rounded(scale, moments, complaint):
    """Below zero by 1e-9 of the largest moment; beyond the triangle's by 1e-3 of the trace."""
    xx, yy, zz = (scale * moment for moment in moments)
    if "negative" in complaint:
        with pytest.raises(DescriptionError, match=complaint):
            make(xx, 0, 0, yy, 0, zz)
    else:
        made, warnings = make(xx, 0, 0, yy, 0, zz)
        assert made.inertia == (xx, 0, 0, yy, 0, zz)
        assert len(warnings) == bool(complaint) and complaint in "".join(warnings)


def test_tensors_that_no_body_has():
    """One of up to a millionth, be it the largest moment or the lowest, is negligible."""
    assert make(*(1,) * 6, mass=0.0) == (None, [])
    for tensor, mass, reason in (((1, 0, 0, 1, 0, 1), -1.0, "mass is -1.0 kg; it must not be neg"),
                                 ((1, 2, 0, 1, 0, 5), 1.0, r"negative principal moment \(-1\)"),
                                 ((1.01e-6, 0, 0, 1e-7, 0, -5e-7), 1.0, "check the signs of ixx"),
                                 ((5e-7, 0, 0, 1e-7, 0, -1.01e-6), 1.0, "check the signs of ixx")):
        with pytest.raises(DescriptionError, match=reason):
            make(*tensor, mass=mass)
    for tensor in ((0,) * 6, (1e-12, 0, 0, 1e-12, 0, 1e-12)):
        ball, (said,) = make(*tensor, mass=2.0)
        assert ball.inertia == pytest.approx((0.002, 0, 0, 0.002, 0, 0.002))  # 2/5 m r², r = 5 cm
        assert "link 'a': the inertia tensor is zero" in said
    for tensor in ((1e-6, 0, 0, 1e-7, 0, -5e-7), (5e-7, 0, 0, 1e-7, 0, -1e-6)):
        _, (said,) = make(*tensor)
        assert f"negative principal moment ({tensor[-1]:.4g})" in said
        assert "a solid sphere of 5 cm radius (0.001 kg m²)" in said
