"""What a folder holds: models and meshes side by side, nothing twice, nothing passed over without a word."""

import os

import numpy as np
import pytest

from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.importing import cache
from cluttergen_jax.importing.readers import find_sources, read_shape, read_source, survey
from cluttergen_jax.importing.run import ObjectConfig
from tests.helpers.shapes import save_box

URDF = """<robot name="r"><link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual></link>
</robot>"""
TOY = """<mujoco><compiler meshdir="parts"/><asset><mesh name="m" file="wheel.stl"/></asset>
<worldbody><body name="toy"><freejoint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""


def names(folder):
    return sorted(source.name for source in find_sources(folder))


def skipped(folder):
    return {each.name.split("/", 1)[1]: each.reason for each in survey(folder).skipped}


@pytest.fixture
def mixed(tmp_path):
    """Sixteen meshes, a sub-folder, a folder with a URDF, an MJCF file, and what is no object."""
    folder = tmp_path / "mixed"
    for index in range(16):
        save_box(folder / f"thing_{index}.{('obj', 'stl', 'ply', 'glb')[index % 4]}")
    save_box(folder / "more" / "can.stl")
    save_box(folder / "lamp" / "shade.obj")
    save_box(folder / "lamp" / "bulb.obj")
    (folder / "lamp" / "lamp.urdf").write_text(URDF.format("package://lamp/shade.obj"))
    save_box(folder / "parts" / "wheel.stl")
    save_box(folder / "parts" / "axle.stl")
    (folder / "toy.xml").write_text(TOY)
    save_box(folder / "thing_0.stl")
    save_box(folder / "toy.obj")
    for name in ("fox.fbx", "notes.txt", "wood.png"):
        (folder / name).write_text("x")
    (folder / "package.xml").write_text("<package/>")
    (folder / "cut.xml").write_text("<mujo")
    return folder


def test_included_files_are_part_of_what_includes_them(tmp_path):
    folder = tmp_path / "kitchen"
    (folder / "bodies").mkdir(parents=True)
    body = '<body name="{}"><freejoint/><geom size=".02 .02 .02" type="box"/></body>'
    body = f"<mujocoinclude>{body}</mujocoinclude>"
    for name in ("pan", "lid"):
        (folder / "bodies" / f"{name}.xml").write_text(body.format(name))
    include = '<include file="bodies/pan.xml"/><include file="bodies/lid.xml"/>'
    (folder / "scene.xml").write_text(f"<mujoco><worldbody>{include}</worldbody></mujoco>")
    sources = find_sources(folder)
    assert [source.name for source in sources] == ["pan", "lid"]
    assert skipped(folder) == dict.fromkeys(
        ("bodies/lid.xml", "bodies/pan.xml"), "included by scene.xml"
    )
    assert [read_shape(source).name for source in sources] == ["pan", "lid"]
    before = cache.cache_key(sources[0], ObjectConfig())
    (folder / "bodies" / "pan.xml").write_text(body.format("pan").replace(".02 ", ".03 "))
    assert cache.cache_key(sources[0], ObjectConfig()) != before


def test_bodies_that_mujoco_makes_are_objects_too(tmp_path):
    pin = '<body name="pin"><geom type="cylinder" size="0.01 0.05"/></body>'
    cup = '<frame euler="0 90 0"><body name="cup"><geom type="box" size="0.03 0.03 0.05"/></body></frame>'
    world = f'<replicate count="2" offset="0.1 0 0">{pin}</replicate>{cup}<body><geom size="0.02"/></body>'
    (tmp_path / "all.xml").write_text(f"<mujoco><worldbody>{world}</worldbody></mujoco>")
    shapes = read_source(tmp_path)
    assert [shape.name for shape in shapes] == ["pin0", "pin1", "cup", "all-3"]
    sizes = [
        np.ptp(join_meshes([piece.mesh for piece in shape.pieces]).bounds, axis=0)
        for shape in shapes
    ]
    np.testing.assert_allclose(sizes[2], [0.1, 0.06, 0.06], atol=1e-6)
    np.testing.assert_allclose(sizes[3], 0.04, atol=1e-3)


def test_an_object_depends_on_its_own_files_alone(mixed):
    (toy,) = (source for source in find_sources(mixed) if source.name == "toy")
    before = cache.cache_key(toy, ObjectConfig())
    save_box(mixed / "another.obj")
    assert cache.cache_key(toy, ObjectConfig()) == before
    save_box(mixed / "parts" / "wheel.stl", 0.06)
    assert cache.cache_key(toy, ObjectConfig()) != before


def test_each_real_folder_is_entered_once(tmp_path):
    folder = tmp_path / "linked"
    save_box(folder / "inner" / "cube.obj")
    # Two links to the folder itself make 2^40 paths, until the system refuses.
    os.symlink(".", folder / "self")
    os.symlink(".", folder / "again")
    os.symlink("..", folder / "inner" / "up")
    os.symlink("../..", folder / "inner" / "out")
    os.symlink("inner", folder / "another")
    os.symlink("nowhere", folder / "broken")
    os.symlink("round", folder / "round")
    assert names(folder) == ["cube"]
    told = skipped(folder)
    assert set(told) == {"self", "again", "inner/up", "inner/out", "another", "broken", "round"}
    assert told["another"] == "a link to a folder that is imported already: linked/inner"
    assert "holds this one" in told["inner/out"]
    assert told["broken"] == told["round"] == "a link that leads nowhere"
