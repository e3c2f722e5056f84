"""Calibration files of each format, compared with OpenCV's projection; and invalid files."""

import re

import cv2
import numpy as np
import pytest
import yaml

from aras_sim_bridge.camera import CameraConfig
from aras_sim_bridge.camera.camera_file import read_camera
from aras_sim_bridge.errors import CameraError
from aras_visual_servo_camera.camera_model import CameraModel

SIZE = (640, 480)
K = np.array([[612.5, 0.0, 331.25], [0.0, 610.0, 228.5], [0.0, 0.0, 1.0]])
RADTAN = (-0.21, 0.11, 0.0012, -0.0008)
EQUIDISTANT = (-0.01, 0.02, -0.01, 0.002)
RATIONAL = (0.45, -0.1, 0.0005, -0.0003, 0.01, 0.8, 0.02, 0.015)
PRISM = (*RATIONAL, 0.002, -0.001, 0.0015, 0.0004)
TILT = (*PRISM, 0.01, -0.02)
NAMES = {4: "plumb_bob", 5: "plumb_bob", 8: "rational_polynomial", 12: "rational_polynomial",
         14: "rational_polynomial"}  # fmt: skip


def ros(D, model):
    def matrix(rows, values):
        values = [float(v) for v in np.ravel(values)]
        return {"rows": rows, "cols": len(values) // rows, "data": values}

    return yaml.safe_dump({
        "image_width": 640, "image_height": 480, "camera_name": "head",
        "camera_matrix": matrix(3, K), "distortion_model": model,
        "distortion_coefficients": matrix(1, D), "rectification_matrix": matrix(3, np.eye(3)),
        "projection_matrix": matrix(3, np.hstack([K, np.zeros((3, 1))])),
    }, sort_keys=False)  # fmt: skip


def rostopic(D, model):
    return yaml.safe_dump({
        "header": {"seq": 1}, "width": 640, "height": 480, "distortion_model": model, "D": list(D),
        "K": K.ravel().tolist(), "R": np.eye(3).ravel().tolist(),
        "P": np.hstack([K, np.zeros((3, 1))]).ravel().tolist(),
    }, sort_keys=False)  # fmt: skip


def ini(D, model):
    def rows(matrix):
        return "\n".join(" ".join(f"{value:.6f}" for value in row) for row in matrix)

    P = np.hstack([K, np.zeros((3, 1))])
    return (
        "# oST version 5.0 parameters\n\n[image]\n\nwidth\n640\n\nheight\n480\n\n[stereo]\n\n"
        f"camera matrix\n{rows(K)}\n\ndistortion\n{' '.join(map(repr, D))}\n\n"
        f"rectification\n{rows(np.eye(3))}\n\nprojection\n{rows(P)}\n"
    )


def opencv(suffix):
    def text(D, model):
        flags = cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
        store = cv2.FileStorage(f"made{suffix}", flags)
        store.write("image_width", 640)
        store.write("image_height", 480)
        if model == "equidistant":
            store.write("fisheye_model", 1)
        store.write("camera_matrix", K)
        store.write("distortion_coefficients", np.array([D]).T)
        return store.releaseAndGetString()

    return text


def kalibr(D, model):
    return yaml.safe_dump({"cam0": {
        "cam_overlaps": [1], "camera_model": "pinhole", "distortion_coeffs": list(D),
        "distortion_model": "radtan" if model == "plumb_bob" else model,
        "intrinsics": [612.5, 610.0, 331.25, 228.5], "resolution": [640, 480],
        "rostopic": "/cam/image_raw"}, "cam1": {
        "T_cn_cnm1": np.eye(4).tolist(), "camera_model": "pinhole", "distortion_coeffs": [],
        "distortion_model": "none", "intrinsics": [500.0, 500.0, 320.0, 240.0],
        "resolution": [640, 480]}})  # fmt: skip


def visp(D, model):
    kind, lens = "perspectiveProjWithoutDistortion", ""
    if model == "equidistant":
        kind = "ProjWithKannalaBrandtDistortion"
        lens = "".join(f"<k{i + 1}>{k!r}</k{i + 1}>" for i, k in enumerate(D))
    elif D:
        kind, lens = "perspectiveProjWithDistortion", f"<kud>{D[0]}</kud><kdu>{-D[0]}</kdu>"
    plain = "<px>600</px><py>600</py><u0>320</u0><v0>240</v0>"
    return f"""<?xml version="1.0"?>
<root><camera><name>Camera</name><image_width>640</image_width><image_height>480</image_height>
<model><type>{kind}</type><px>612.5</px><py>610.0</py><u0>331.25</u0><v0>228.5</v0>{lens}</model>
{f"<model><type>perspectiveProjWithoutDistortion</type>{plain}</model>" if D else ""}
</camera></root>
"""


def camodocal(D, model):
    fisheye = model == "equidistant"
    lens = dict(zip(("k2", "k3", "k4", "k5") if fisheye else ("k1", "k2", "p1", "p2"), D,
                    strict=True))  # fmt: skip
    pinhole = dict(zip(("mu", "mv", "u0", "v0") if fisheye else ("fx", "fy", "cx", "cy"),
                       (612.5, 610.0, 331.25, 228.5), strict=True))  # fmt: skip
    return "%YAML:1.0\n---\n" + yaml.safe_dump({
        "model_type": "KANNALA_BRANDT" if fisheye else "PINHOLE", "camera_name": "head",
        "image_width": 640, "image_height": 480,
        **({} if fisheye else {"distortion_parameters": lens}),
        "projection_parameters": {**(lens if fisheye else {}), **pinhole}}, sort_keys=False)


def orb_slam(camera):
    def text(D, model):
        fisheye = model == "equidistant"
        names = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
        values = {"fx": 612.5, "fy": 610.0, "cx": 331.25, "cy": 228.5,
                  **dict(zip(names, D, strict=False))}  # fmt: skip
        return (f'%YAML:1.0\n\nCamera.type: "{"KannalaBrandt8" if fisheye else "PinHole"}"\n'
                + "".join(f"{camera}.{key}: {value!r}\n" for key, value in values.items())
                + "Camera.width: 640\nCamera.height: 480\nCamera.fps: 20\n"
                "IMU.T_b_c1: !!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: f\n"
                "   data: [1.0, 0.0]\n")

    return text


WRITERS = {"ros.yaml": ros, "topic.yaml": rostopic, "ost.ini": ini, "cv.yaml": opencv(".yaml"),
           "cv.xml": opencv(".xml"), "cv.json": opencv(".json"), "chain.yaml": kalibr,
           "visp.xml": visp}  # fmt: skip
# A part of such a file can look complete, so the test of incomplete files leaves them out.
SLAM = {"camodocal.yaml": camodocal, "orb2.yaml": orb_slam("Camera"),
        "orb3.yaml": orb_slam("Camera1"),
        "open_vins.yaml": lambda D, model: "%YAML:1.0\n\n" + kalibr(D, model)}  # fmt: skip
ALL = [(*RADTAN[:2], *RADTAN[2:]), (*RADTAN, -0.02), RATIONAL, PRISM, TILT]
CASES = [
    *((name, D, NAMES[len(D)]) for name in ("ros.yaml", "topic.yaml", "ost.ini", "cv.yaml",
                                            "cv.xml", "cv.json") for D in ALL),
    *((name, EQUIDISTANT, "equidistant") for name in (*WRITERS, *SLAM) if name != "ost.ini"),
    *((name, RADTAN, "plumb_bob") for name in SLAM), ("orb3.yaml", (*RADTAN, -0.02), "plumb_bob"),
    ("chain.yaml", RADTAN, "plumb_bob"),
    ("visp.xml", (-0.2, 0.0, 0.0, 0.0), "plumb_bob"), ("visp.xml", (), "plumb_bob"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "D", "model"), CASES)
def test_a_projected_grid_is_opencvs(tmp_path, name, D, model):
    (tmp_path / name).write_text({**WRITERS, **SLAM}[name](D, model))
    camera = CameraConfig.from_mapping(read_camera(tmp_path / name))
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 15), np.linspace(-0.4, 0.4, 13))
    grid = np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)])
    project = cv2.projectPoints if model != "equidistant" else cv2.fisheye.projectPoints
    expected = project(grid[:, None], np.zeros(3), np.zeros(3), K, np.array(D or (0.0,) * 4))[0]
    pixels = camera.projection.project(grid)
    assert np.abs(pixels - expected.reshape(-1, 2)).max() < 1e-6
    rays = camera.projection.unproject(pixels)
    assert np.abs(rays / rays[:, 2:] - grid).max() < 1e-9
    assert (camera.width, camera.height) == SIZE
    info = camera.make_intrinsics()  # what the camera node and the loop get
    read = CameraModel(*SIZE, tuple(info.K.ravel()), info.D, info.model)
    assert np.abs(np.column_stack(read.project(*grid[:, :2].T)) - pixels).max() < 1e-6
    x, y, valid = read.normalise(*pixels.T)
    assert valid.all() and np.abs(np.column_stack([x, y]) - grid[:, :2]).max() < 1e-9


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_is_cut_off_is_refused_or_says_the_same(tmp_path, name):
    model = "plumb_bob"
    D = {"visp.xml": (-0.2, 0.0, 0.0, 0.0), "chain.yaml": RADTAN}.get(name, (*RADTAN, -0.02))
    text, path = WRITERS[name](D, model), tmp_path / name
    path.write_text(text)
    whole = read_camera(path)
    lens = {key: whole[key] for key in ("camera_matrix", "distortion_coefficients", "width")}
    for end in range(0, len(text), 7):
        path.write_text(text[:end])
        try:
            found = read_camera(path)
        except CameraError as error:
            assert str(path) in str(error) and "\n" not in str(error), str(error)
        else:
            assert {key: found.get(key) for key in lens} == lens, text[:end][-80:]


ROS = ros((*RADTAN, -0.02), "plumb_bob")
VINS, ORB = camodocal(RADTAN, "plumb_bob"), orb_slam("Camera")(RADTAN, "plumb_bob")
CHAIN, STORE, VISP = kalibr(RADTAN, "plumb_bob"), opencv(".xml")(RADTAN, ""), visp(RADTAN[:1], "")


@pytest.mark.parametrize(("name", "text", "message"), [
    ("a.yaml", ROS.replace("plumb_bob", "fov"), "distortion_model 'fov' is not supported"),
    ("a.yaml", ROS.replace("plumb_bob", "equidistant"), "5 numbers, but distortion_model eq"),
    ("a.yaml", ros(RATIONAL, "plumb_bob"), "8 numbers.*plumb_bob needs 4 or 5.*set "
                                           "distortion_model to rat"),
    ("a.yaml", ros(RATIONAL[:6], "plumb_bob"), "has 6 numbers"),
    ("a.yaml", ROS.replace("width: 640", "width: 1280"), "cx = 331.25 px .*image_width 1280"),
    ("a.yaml", ROS.replace("height: 480", "height: 240"), "cy = 228.5 px .*image_height 240"),
    ("a.yaml", ROS.replace("width: 640", "width: 0"), "image_width is 0"),
    ("a.yaml", ROS.replace("width: 640", "width: 640.5"), "image_width is 640.5"),
    ("a.yaml", ROS.replace("612.5", "0.0"), "focal lengths"),
    ("a.yaml", ROS.replace("612.5", ".nan"), "camera_matrix.data"),
    ("a.yaml", ROS.replace("612.5", "6.125"), "fx = 6.125 and fy = 610"),
    ("a.yaml", ROS.replace("  - -0.02\n", ""), "1 rows and 5 cols, but its data have 4"),
    ("a.yaml", ROS.replace("rows: 3", "rows: 4", 1), "camera_matrix has 4 rows"),
    ("a.yaml", CHAIN.replace("radtan", "fov"), "cam0: distortion_model 'fov'"),
    ("a.yaml", CHAIN.replace("pinhole", "omni"), "camera_model 'omni' is not supported"),
    ("a.yaml", CHAIN.replace("resolution", "size"), "cam0: resolution is missing"),
    ("a.yaml", VINS.replace("PINHOLE", "MEI"), "model_type 'MEI' is not supported: calibrate with"),
    ("a.yaml", VINS.replace("p2:", "p3:"), "distortion_parameters: p2 is missing"),
    ("a.yaml", VINS.replace("cx: 331.25", "cx: .nan"), "projection_parameters"),
    ("a.yaml", VINS.replace("height: 480", "height: 480.5"), "image_height is 480.5"),
    ("a.yaml", ORB.replace("Camera.cy", "Camera.c"), "Camera.cy is missing"),
    ("a.yaml", ORB.replace("Camera.width: 640", "Camera.width: 64"), "cx = 331.25 px"),
    ("a.yaml#cam7", CHAIN, "has no camera 'cam7': select one of cam0, cam1"),
    ("a.xml", STORE.replace("camera_matrix", "matrix"), "camera_matrix is missing"),
    ("a.xml", STORE.replace("distortion_coefficients", "other"), "distortion_coefficients are mis"),
    ("a.xml", re.sub("<image_.*>", "", STORE), "image_width and image_height are missing"),
    ("a.xml", VISP.replace("<kdu>0", "<kdu>-0"), "<kud> -0.21 and <kdu> -0.21 must have opposite "
                                                 "signs"),
    ("a.xml", VISP.replace("perspectiveProjWithDistortion", "fov"), "not supported|<type> 'fov'"),
    ("a.xml", VISP.replace("<py>610.0</py>", ""), "<py>"),
    ("a.xml", "<robot name='x'/>", "root <robot>, not a camera calibration"),
    ("a.yaml", "- 1\n", "neither a camera preset nor a calibration"),
    ("a.yaml", re.sub("image_.*", "", ROS), "image_width"),
])  # fmt: skip
def test_what_contradicts_itself_or_is_not_served_is_named(tmp_path, name, text, message):
    (tmp_path / name.partition("#")[0]).write_text(text)
    with pytest.raises(CameraError, match=message) as refused:
        CameraConfig.from_mapping(read_camera(tmp_path / name))
    assert str(tmp_path / name.partition("#")[0]) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_preset_names_its_calibration(tmp_path):
    (tmp_path / "head.yaml").write_text(ROS)
    (tmp_path / "chain.yaml").write_text(CHAIN)
    preset = tmp_path / "preset.yaml"
    preset.write_text("calibration: head.yaml\nupdate_rate: 60.0\neffects: {noise_stddev: 2.0}\n")
    camera = CameraConfig.from_mapping(read_camera(preset))
    assert camera.update_rate == 60.0 and camera.effects.noise_stddev == 2.0
    assert camera.camera_matrix == (612.5, 610.0, 331.25, 228.5)
    preset.write_text("calibration: chain.yaml#cam1\n")
    assert CameraConfig.from_mapping(read_camera(preset)).camera_matrix[0] == 500.0
    for key in ("width", "horizontal_fov"):
        preset.write_text(f"calibration: head.yaml\n{key}: 320\n")
        with pytest.raises(CameraError, match=f"{key} is .* remove {key}"):
            read_camera(preset)
    with pytest.raises(CameraError, match="relative path"):
        CameraConfig.from_mapping({"calibration": "head.yaml"})


@pytest.mark.parametrize(("model", "D"), [
    ("plumb_bob", (0.1, -0.5, 0.001, 0.0, 0.0)),
    ("rational_polynomial", (0.2, -0.5, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0)),
    ("equidistant", (-0.05, -0.2, 0.1, -0.1)),
])  # fmt: skip
def test_a_polynomial_that_folds_outside_of_the_image(model, D):
    """It serves every pixel, and what lies beyond the fold does not come back into the image."""
    fx, fy, cx, cy = 612.5, 610.0, 331.25, 228.5
    keys = {"width": 640, "height": 480, "distortion_model": model, "distortion_coefficients": D}
    camera = CameraConfig.from_mapping({**keys, "camera_matrix": (fx, fy, cx, cy)})
    u, v = (side.ravel() for side in np.meshgrid(np.arange(0, 640, 7.0), np.arange(0, 480, 7.0)))
    rays = camera.projection.unproject(np.column_stack([u, v]))
    info = camera.make_intrinsics()
    read = CameraModel(*SIZE, tuple(info.K.ravel()), info.D, model)
    x, y, valid = read.normalise(u, v)
    assert valid.all() and np.abs(rays[:, :2] / rays[:, 2:] - np.column_stack([x, y])).max() < 1e-9
    u, v = read.project(np.array([1.1, 2.2, 4.9]), np.array([1.0, -1.8, 1.5]))
    assert ((u < 0) | (u > 639) | (v < 0) | (v > 479)).all()
    with pytest.raises(CameraError, match="radius stops increasing .*inside"):
        CameraConfig.from_mapping({**keys, "camera_matrix": (fx / 4, fy / 4, cx, cy)})
