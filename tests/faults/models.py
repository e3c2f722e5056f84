"""Faults of models: invalid descriptions and meshes, and many spawns and deletions."""

from __future__ import annotations

import random
from pathlib import Path

from gazebo_msgs.srv import DeleteModelRequest, SpawnModelRequest

from .bed import Bed, UnansweredError
from .outcome import Outcome
from .traffic import judged

BALL = """<robot name="ball"><link name="ball"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><sphere radius="0.1"/></geometry></visual>
<collision><geometry><sphere radius="0.1"/></geometry></collision></link></robot>"""
CRATE = """<sdf version="1.6"><model name="crate"><pose>0 3 1 0 0 0</pose><link name="crate">
<inertial><mass>2</mass></inertial><collision name="c"><geometry><box><size>.2 .2 .2</size></box>
</geometry></collision><visual name="v"><geometry><box><size>.2 .2 .2</size></box></geometry>
</visual></link></model></sdf>"""
MESH = """<robot name="m"><link name="m"><visual><geometry><mesh filename="{}"/></geometry></visual>
</link></robot>"""
NUMBERS = ("nan", "inf", "-inf", "1e308", "-1", "0", "1e-300", "", "x", "1 2", "0x10", "\u0663")


def hostile(bed: Bed, scale: float, seed: int) -> Outcome:
    """Send descriptions that are damaged at random places, entities, and invalid meshes."""
    draw = random.Random(seed)
    with bed.group("hostile models and meshes") as outcome:
        texts = [_damaged(draw, draw.choice((BALL, CRATE))) for _ in range(round(120 * scale) + 5)]
        texts += [MESH.format(path) for path in _meshes(bed.directory, draw)]
        texts += list(_bombs())
        for text in texts:
            outcome.injected += 1
            kind = "sdf" if "<sdf" in text else "urdf"
            request = SpawnModelRequest(model_name="hostile", model_xml=text)
            request.initial_pose.orientation.w = 1.0
            request.initial_pose.position.y = 5.0
            try:
                if bed.call(f"/gazebo/spawn_{kind}_model", request).success:
                    bed.call("/gazebo/delete_model", DeleteModelRequest("hostile"))
            except UnansweredError as error:  # refusing is an answer, and the usual one
                if error.hangs:
                    outcome.hung.append(f"{error}: {text[:200]}")
                    continue
            outcome.survived += 1
        judged(bed, outcome, 0, "after hostile models")
    return outcome


def _damaged(draw: random.Random, text: str) -> str:
    """Return a description with a part removed, doubled, swapped or replaced by an invalid number.
    """
    pieces = text.replace(">", ">\0").split("\0")
    for _ in range(draw.randint(1, 3)):
        at = draw.randrange(len(pieces))
        how = draw.randrange(4)
        if how == 0:
            pieces[at] = ""
        elif how == 1:
            pieces[at] *= 2
        elif how == 2:
            other = draw.randrange(len(pieces))
            pieces[at], pieces[other] = pieces[other], pieces[at]
        else:
            for old in ('"1"', '"0.1"', "2", ".2", "0 3 1"):
                if old in pieces[at]:
                    new = draw.choice(NUMBERS)
                    pieces[at] = pieces[at].replace(old, f'"{new}"' if '"' in old else new)
    return "".join(pieces)


def _meshes(folder: Path, draw: random.Random) -> list[str]:
    contents = {
        "empty.stl": b"", "short.stl": b"\0" * 83, "lies.stl": b"\0" * 80 + b"\xff\xff\xff\x7f",
        "random.stl": draw.randbytes(5000), "text.obj": b"v 1 2\nf 9 9 9\n" * 50,
        "deep.dae": b"<a>" * 20_000, "none.dae": b"<COLLADA/>",
        "nan.obj": b"v nan 0 0\n" * 3 + b"f 1 2 3",
    }  # fmt: skip
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    paths = [f"file://{folder / name}" for name in contents]
    return [*paths, "file:///dev/zero", "file:///etc/shadow", "package://none/x.stl", "x", ""]


def _bombs() -> list[str]:
    laughs = "".join(
        f'<!ENTITY l{k + 1} "{f"&l{k};" * 10}">' for k in range(9)
    )
    return [
        f'<!DOCTYPE robot [<!ENTITY l0 "ha">{laughs}]><robot name="&l9;"><link name="a"/></robot>',
        '<!DOCTYPE robot [<!ENTITY f SYSTEM "file:///etc/shadow">]><robot name="&f;"/>',
        "<robot>" * 50_000,
        "<robot name='x'>" + "<link name='a'/>" * 20_000 + "</robot>",
        "\0" * 1000,
        "\ud83e".encode("utf-8", "replace").decode(),
    ]


def cycles(bed: Bed, scale: float, seed: int) -> Outcome:
    """Spawn and delete a model repeatedly."""
    with bed.group("spawn and delete") as outcome:
        for k in range(max(round(100 * scale), 10)):
            outcome.injected += 1
            kind, text = ("urdf", BALL) if k % 2 else ("sdf", CRATE)
            request = SpawnModelRequest(model_name=f"guest{k % 3}", model_xml=text)
            request.initial_pose.orientation.w = 1.0
            request.initial_pose.position.y = 4.0
            try:
                spawned = bed.call(f"/gazebo/spawn_{kind}_model", request)
                deleted = bed.call("/gazebo/delete_model", DeleteModelRequest(f"guest{k % 3}"))
            except UnansweredError as error:
                (outcome.hung if error.hangs else outcome.lost).append(str(error))
                continue
            if spawned.success and deleted.success:
                outcome.survived += 1
            else:
                outcome.lost.append(spawned.status_message or deleted.status_message)
        judged(bed, outcome, 0, "after the cycles")
    return outcome


GROUPS = (hostile, cycles)
