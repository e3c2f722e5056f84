"""Principal axes of inertia tensors; impossible tensors are refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from aras_sim_bridge.description.inertia import inertia_tensor, make_inertial, principal_axes
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


def test_principal_axes_turn_and_never_mirror():
    mirrored = 0
    for inertia in tensors():
        moments, axes = principal_axes(inertia)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        np.testing.assert_allclose(
            axes @ np.diag(moments) @ axes.T, inertia_tensor(inertia), atol=1e-12
        )
        mirrored += np.linalg.det(np.linalg.eigh(inertia_tensor(inertia))[1]) < 0.0
    assert 0 < mirrored < 20


def test_a_diagonal_tensor_keeps_its_axes():
    moments, axes = principal_axes((3.0, 0.0, 0.0, 1.0, 0.0, 2.0))
    assert moments.tolist() == [3.0, 1.0, 2.0]
    assert (axes == np.eye(3)).all()


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


def test_tensors_that_no_body_has():
    warnings = []
    assert make_inertial("link 'a'", 0.0, (0, 0, 0), (0, 0, 0), (1,) * 6, warnings) is None
    assert not warnings
    with pytest.raises(DescriptionError, match="mass is -1.0 kg; it must not be negative"):
        make_inertial("link 'a'", -1.0, (0, 0, 0), (0, 0, 0), (1, 0, 0, 1, 0, 1), warnings)
    with pytest.raises(DescriptionError, match=r"negative principal moment \(-1\)"):
        make_inertial("link 'a'", 1.0, (0, 0, 0), (0, 0, 0), (1, 2, 0, 1, 0, 5), warnings)
    assert not warnings
    ball = make_inertial("link 'a'", 2.0, (0, 0, 0), (0, 0, 0), (0,) * 6, warnings)
    assert ball.inertia == pytest.approx((0.002, 0, 0, 0.002, 0, 0.002))  # 2/5 m r², r = 5 cm
    assert "link 'a': the inertia tensor is zero" in warnings.pop()
    flat = (1.0, 0.0, 0.0, 100.0, 0.0, 1.0)
    assert make_inertial("link 'a'", 1.0, (0, 0, 0), (0, 0, 0), flat, warnings).inertia == flat
    assert "1, 1, 100 break the triangle inequality" in warnings.pop()
    make_inertial("link 'a'", 1.0, (0, 0, 0), (0, 0, 0), (1, 0, 0, 1, 0, 2.003), warnings)
    assert not warnings, "a CAD export's rounding"


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_how_much_a_tensor_may_be_rounded(scale):
    """Below zero by 1e-9 of the largest moment; beyond the triangle's by 1e-3 of the trace."""
    def read(*moments):
        warnings = []
        xx, yy, zz = (scale * moment for moment in moments)
        make_inertial("w", 1.0, (0, 0, 0), (0, 0, 0), (xx, 0, 0, yy, 0, zz), warnings)
        return len(warnings)

    assert read(1.0, 1.0, -1e-9) == read(1.0, 1.0, -0.9e-9) == 0
    assert read(1.0, 1.0, 0.0) == read(1.0, 2.0, 3.0) == 0
    with pytest.raises(DescriptionError, match="negative principal moment"):
        read(1.0, 1.0, -1.1e-9)
    for largest, count in ((3.0059, 0), (3.0062, 1)):  # 0.001 of 6.006
        assert read(largest, 1.0, 2.0) == read(2.0, largest, 1.0) == count


def test_a_tensor_is_negligible_up_to_a_millionth():
    """Be it the largest moment or the lowest."""
    for largest, lowest in ((1e-6, -5e-7), (1.01e-6, -5e-7), (5e-7, -1e-6), (5e-7, -1.01e-6)):
        warnings = []
        tensor = (largest, 0.0, 0.0, 1e-7, 0.0, lowest)
        if max(largest, -lowest) <= 1e-6:
            make_inertial("w", 1.0, (0, 0, 0), (0, 0, 0), tensor, warnings)
            assert f"negative principal moment ({lowest:.4g})" in warnings[0]
            assert "a solid sphere of 5 cm radius (0.001 kg m²)" in warnings[0]
        else:
            with pytest.raises(DescriptionError, match="check the signs of ixx … izz"):
                make_inertial("w", 1.0, (0, 0, 0), (0, 0, 0), tensor, warnings)
