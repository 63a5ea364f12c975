"""Masses that files state: taken where they can be true, refused with a reason where not; joints said."""

import numpy as np
import pytest

from cluttergen_jax.assets.body import make_object
from cluttergen_jax.assets.mass import MassProperties, choose_mass, combine_masses, mass_properties
from cluttergen_jax.assets.object_files import read_object, write_object
from cluttergen_jax.cli.pools import pool_table
from cluttergen_jax.importing.readers import ReadOptions, read_source
from cluttergen_jax.importing.readers.mjcf import read_mjcf
from cluttergen_jax.importing.readers.source import ObjectFile
from tests.helpers.shapes import slab

HALF = np.array([0.05, 0.03, 0.02])
DENSITY = 500.0
UNIFORM = mass_properties(slab(HALF), DENSITY)

# A box of 100 x 60 x 40 mm, 0.4 kg, and its lid of 100 x 60 x 4 mm, 0.1 kg, which leans back by 60 degrees.
URDF = """<robot name="r">
  <link name="box"><visual><geometry><box size="0.1 0.06 0.04"/></geometry></visual>
    <inertial><origin xyz="0 0 -0.005"/><mass value="{box}"/>
      <inertia ixx="1.6e-4" iyy="3.5e-4" izz="4.2e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lid"><visual><origin xyz="0 0.03 0"/><geometry><box size="0.1 0.06 0.004"/></geometry></visual>
    <inertial><origin xyz="0 0.03 0"/><mass value="{lid}"/>
      <inertia ixx="3e-5" iyy="8.3e-5" izz="1.1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="box"/><child link="lid"/><origin xyz="0 -0.03 0.022"/>
    <axis xyz="1 0 0"/><limit lower="1.0471975511965976" upper="2"/></joint>
</robot>"""


def stated(mass, inertia=None, center=(0.0, 0.0, 0.0)):
    inertia = (
        UNIFORM.inertia * mass / UNIFORM.mass if inertia is None else np.asarray(inertia, float)
    )
    return combine_masses([MassProperties(mass, np.array(center), inertia)])


def judged(mass, inertia=None, center=(0.0, 0.0, 0.0)):
    return choose_mass(stated(mass, inertia, center), slab(HALF), UNIFORM, DENSITY)


def test_a_urdf_weighs_what_its_links_weigh_and_its_frozen_joint_is_named(tmp_path):
    (tmp_path / "chest.urdf").write_text(URDF.format(box=0.4, lid=0.1))
    (shape,) = read_source(tmp_path / "chest.urdf")
    asset = make_object(shape)
    assert asset.mass == pytest.approx(0.5)
    assert asset.notes == ("frozen joints: 'hinge' (revolute) at 60 degrees",)
    # By hand: the lid's centre is 3 cm from the hinge, at 60 degrees.
    lid = np.array([0.0, -0.03 + 0.03 * 0.5, 0.022 + 0.03 * np.sqrt(3) / 2])
    center = (0.4 * np.array([0.0, 0.0, -0.005]) + 0.1 * lid) / 0.5
    np.testing.assert_allclose(shape.stated.body.center, center, atol=1e-9)
    lowest = min(part.vertices[:, 2].min() for part in asset.parts)
    assert asset.center_of_mass[2] - lowest == pytest.approx(center[2] + 0.02, abs=5e-4)
    apart = 0.4 * 0.1 / 0.5 * (lid - [0.0, 0.0, -0.005])[1:] @ (lid - [0.0, 0.0, -0.005])[1:]
    assert asset.inertia[0, 0] == pytest.approx(1.6e-4 + 3e-5 + apart, rel=1e-6)
    # Through a pool's files and into the table that import and inspect print.
    write_object(tmp_path / "chest", asset)
    assert read_object(tmp_path / "chest").notes == asset.notes
    assert "  - chest: frozen joints: 'hinge' (revolute) at" in pool_table([asset])
    (given,) = read_source(tmp_path / "chest.urdf", ReadOptions(mass=2.0))
    assert make_object(given).mass == 2.0


@pytest.mark.parametrize(
    ("mass", "inertia", "reason"),
    [
        (12.0, None, "50,000 kg/m\\^3"),
        (0.001, None, "4 kg/m\\^3"),
        (-1.0, None, "positive"),
        (np.nan, None, "positive"),
        (0.1, np.eye(3) * 1e-4, "placeholder"),
        (1.0, np.eye(3), "placeholder"),
    ],
)
def test_a_mass_that_cannot_be_is_refused(mass, inertia, reason):
    body, refusal = judged(mass, inertia)
    assert body is UNIFORM
    with pytest.raises(AssertionError, match=reason):
        raise AssertionError(refusal)


@pytest.mark.parametrize(
    ("inertia", "center", "reason"),
    [
        (np.diag([1.0, 1.0, 1.0]), (0, 0, 0), "times that of a body of this size"),
        (np.diag([1e-6, 1e-6, 1e-6]), (0, 0, 0), "times that of a body of this size"),
        (np.diag([1e-4, 1e-4, 3e-4]), (0, 0, 0), "no body"),
        (np.diag([-1e-4, 2e-4, 2e-4]), (0, 0, 0), "no body"),
        (np.eye(3) * 2.5e-4, (0, 0, 0), "not round"),
        (np.zeros((3, 3)), (0, 0, 0), "none is given"),
        (np.diag([np.nan, 2e-4, 2e-4]), (0, 0, 0), "finite"),
        (np.diag([1.3e-4, 3.3e-4, 4.2e-4]), (0, 0, 0.1), "centre of mass"),
    ],
)
def test_a_mass_stays_where_only_the_inertia_cannot_be(inertia, center, reason):
    body, refusal = judged(0.3, inertia, center)
    assert body.mass == 0.3
    np.testing.assert_allclose(body.center, UNIFORM.center)
    np.testing.assert_allclose(body.inertia, UNIFORM.inertia * 0.3 / UNIFORM.mass)
    assert reason in refusal
    assert "0.3 kg is taken" in refusal


def test_mjcf_inertia_is_that_of_the_compiled_bodies(tmp_path):
    path = tmp_path / "drawer.xml"
    path.write_text(
        """<mujoco><worldbody><body name="chest" pos="1 2 3"><freejoint/>
          <inertial pos="0 0 -0.005" mass="0.4" diaginertia="1.6e-4 3.5e-4 4.2e-4"/>
          <geom type="box" size=".05 .03 .02"/>
          <body name="drawer" pos="0 0.01 0"><joint name="pull" type="slide" axis="0 1 0" ref="0.02"/>
            <geom type="box" size=".04 .03 .01" mass="0.1"/></body>
        </body></worldbody></mujoco>"""
    )
    (shape,) = read_source(path)
    assert shape.notes == ("frozen joints: 'pull' (slide) at 0.02 m",)
    alone = read_mjcf(ObjectFile(path, "mjcf", "drawer", "drawer", body="drawer"))
    assert "taken without 'chest', on which it hangs by 'pull'" in alone.notes[0]
    assert not alone.joints
    body = shape.stated.body
    assert body.mass == pytest.approx(0.5)
    np.testing.assert_allclose(body.center, [1, 2.002, 2.996], atol=1e-9)
    drawer = 0.1 / 3 * (0.03**2 + 0.01**2)
    assert body.inertia[0, 0] == pytest.approx(1.6e-4 + drawer + 0.08 * (0.01**2 + 0.005**2))
