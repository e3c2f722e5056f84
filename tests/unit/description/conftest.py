"""World files of the description tests."""

import pytest

from aras_sim_bridge.description import world_file


@pytest.fixture
def read(tmp_path):
    def world(*inside):
        path = tmp_path / "a.world"
        text = "".join(inside)
        path.write_text(f"<sdf version='1.6'><world name='default'>{text}</world></sdf>")
        return world_file.load_world(str(path))

    return world
