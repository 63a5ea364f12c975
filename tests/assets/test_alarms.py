"""Files that contradict themselves by a factor of three are flagged: what is seen, what collides, mass."""

import re

import pytest

from cluttergen_jax.assets.body import BodyConfig, make_object
from cluttergen_jax.assets.deviation import size_alarm
from cluttergen_jax.cli.pools import pool_table
from cluttergen_jax.importing.readers import read_source
from tests.helpers.shapes import slab

CARTON = (0.04, 0.03, 0.08)


def points(half, center=(0.0, 0.0, 0.0)):
    return slab(half, center).vertices


@pytest.mark.parametrize(
    ("colliding", "told"),
    [
        (points((0.09, 0.09, 0.12)), "80 x 60 x 160 mm.*180 x 180 x 240 mm.*10.1 times"),
        (points((0.02, 0.0005, 0.02)), "80 x 60 x 160 mm.*40 x 1 x 40 mm.*480 times"),
        (points((0.02, 0.0, 0.02)), "40 x 0 x 40 mm"),
        (points(CARTON, (0.25, 0, 0)), "80 x 60 x 160 mm.*80 x 60 x 160 mm.*4.1[23] times"),
    ],
)
def test_what_collides_is_about_what_is_seen(colliding, told):
    found = size_alarm(points(CARTON), colliding)
    assert re.search(told, found)
    # Whichever of the two is the wrong one.
    assert found.split("together")[1] == size_alarm(colliding, points(CARTON)).split("together")[1]


URDF = """<robot name="carton"><link name="box">
  <visual><geometry><box size="0.08 0.06 0.16"/></geometry></visual>
  <collision><geometry><box size="0.18 0.18 0.24"/></geometry></collision>
  <inertial><mass value="40"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
</link></robot>"""
MJCF = """<mujoco><worldbody><body name="carton">
  <geom type="box" size=".04 .03 .08" contype="0" conaffinity="0" mass="40"/>
  <geom type="box" size=".09 .09 .12" group="3" mass="0"/>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize(("name", "text"), [("carton.urdf", URDF), ("carton.xml", MJCF)])
def test_a_file_that_contradicts_itself_is_flagged_and_its_table_says_so(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    (shape,) = read_source(tmp_path / name)
    asset = make_object(shape, BodyConfig(tier="light"))
    size, mass = asset.flags
    assert size.startswith("what is seen (80 x 60 x 160 mm) and what collides (180 x 180 x 240 mm)")
    assert mass.startswith("its stated mass of 40 kg does not fit its size")
    assert any("40 kg is not taken" in note for note in asset.notes)
    assert f"  ! carton: {mass}" in pool_table([asset])
