"""Objects with a friction of their own: slippery against everything, in every model that is made of them."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from cluttergen_jax.assets.obj import write_parts
from cluttergen_jax.assets.object_files import object_hash, read_object, write_object
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.placement.world import make_world
from cluttergen_jax.scene import Scene
from cluttergen_jax.scene.export.mjcf import scene_xml
from tests.helpers.worlds import TOP, box

STABILITY = StabilityConfig()
CONTACT = ContactConfig()
TABLE = cuboid_table()
FLAT = (0.05, 0.05, 0.01)


def scene_of(*frictions):
    """Flat boxes on top of each other, each with a friction of its own or none."""
    objects = tuple(replace(box(f"box-{i}", FLAT), friction=own) for i, own in enumerate(frictions))
    poses = np.array([[0, 0, TOP + FLAT[2] * (2 * i + 1), 1, 0, 0, 0] for i in range(len(objects))])
    names = tuple(asset.name for asset in objects)
    return Scene(names, objects, poses.astype(np.float32), TABLE, STABILITY, CONTACT)


def slid(model, degrees):
    """How far each object moves along x within half a second where gravity is tilted, metres."""
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    model.opt.gravity[:] = 9.81 * np.array(
        [np.sin(np.radians(degrees)), 0, -np.cos(np.radians(degrees))]
    )
    start = data.qpos.copy().reshape(-1, 7)
    mujoco.mj_step(model, data, round(0.5 / model.opt.timestep))
    return (data.qpos.reshape(-1, 7) - start)[:, 0]


def by_spec(scene, folder):
    return scene.to_mjspec().compile()


def by_file(scene, folder):
    for asset in scene.objects:
        write_parts(folder / "assets" / "objects" / asset.name, asset)
    (folder / "scenes").mkdir()
    path = folder / "scenes" / "000000.xml"
    path.write_bytes(scene_xml(scene.objects, scene.poses, TABLE, STABILITY, CONTACT))
    return mujoco.MjModel.from_xml_path(str(path))


def beside_others(scene, folder):
    spec = mujoco.MjSpec.from_string(
        '<mujoco><default><geom friction="3 0.1 0.1"/></default><worldbody/></mujoco>'
    )
    scene.attach_to(spec)
    return spec.compile()


def by_world(scene, folder):
    """The physics model that scenes are made with."""
    model = make_world(scene.objects, TABLE, STABILITY, CONTACT).layout.model
    model.qpos0[:] = scene.poses.ravel()
    return model


MODELS = (by_spec, by_file, beside_others, by_world)


# tan 15 degrees is 0.27: the default of 0.5 holds, 0.1 does not.
@pytest.mark.parametrize("make", MODELS)
@pytest.mark.parametrize(
    ("frictions", "degrees", "moves"),
    [
        ((None,), 15, (False,)),
        ((0.1,), 15, (True,)),
        # The more slippery of two decides, whichever lies above.
        ((0.9, 0.1), 15, (False, True)),
        ((0.1, 0.9), 15, (True, True)),
        ((None, 0.1), 15, (False, True)),
        # tan 35 degrees is 0.70: the default slides, and rubber holds on the same table.
        ((None,), 35, (True,)),
        ((0.9,), 35, (False,)),
    ],
)
def test_what_slides_on_a_slope(tmp_path, make, frictions, degrees, moves):
    way = slid(make(scene_of(*frictions), tmp_path), degrees)
    assert tuple(way > 0.05) == moves, way
    assert (way[~np.array(moves)] < 0.005).all()


def test_it_is_kept_on_disk_and_absent_where_there_is_none(tmp_path):
    plain = box("box", FLAT)
    slippery = replace(box("box", FLAT), friction=0.1)
    for name, asset in (("plain", plain), ("slippery", slippery)):
        write_object(tmp_path / name, asset)
        assert read_object(tmp_path / name).friction == asset.friction
        assert object_hash(read_object(tmp_path / name)) == object_hash(asset)
    assert object_hash(plain) != object_hash(slippery)
    assert b"friction" not in (tmp_path / "plain" / "object.json").read_bytes()
    # What digest an object without a friction of its own had before there was any.
    assert object_hash(plain) == "f7ef94af8fd4da0950ad9e78d54d86d833a19c7477be484105911d70b6164f45"
    alone = mujoco.MjModel.from_xml_path(str(tmp_path / "slippery" / "object.xml"))
    assert alone.geom_friction[0, 0] == pytest.approx(0.1)
