"""URDF: numbers that are too few, mimicked joints, materials by name, paths of another machine, xacro."""

import re

import numpy as np
import pytest

from cluttergen_jax.assets.mesh import join_meshes
from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers import read_source
from tests.helpers.cases import CASES

BOX = '<box size=".1 .06 .04"/>'


def write(folder, body, name="thing.urdf"):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_text(f'<robot name="r">{body}</robot>')
    return folder / name


def link(name="a", form=BOX, inside="", more=""):
    return f'<link name="{name}"><visual><geometry>{form}</geometry>{inside}</visual>{more}</link>'


def read(path):
    (shape,) = read_source(path)
    return shape


def size_of(shape):
    return np.ptp(join_meshes([piece.mesh for piece in shape.pieces]).bounds, axis=0)


def test_one_number_scales_all_three_axes():
    shape = read(CASES / "06_urdf_scalar_scale")
    np.testing.assert_allclose(size_of(shape), [0.1, 0.06, 0.04], atol=1e-6)


def test_a_colour_without_alpha_is_opaque():
    assert read(CASES / "07_urdf_rgba3").pieces[0].rgba == (0.8, 0.1, 0.1, 1.0)


CLEAR = '<material name="clear"><color rgba="1 0 0 0"/></material>'
HANDLE = '<visual><geometry><sphere radius="0.01"/></geometry></visual>'


def test_what_is_clear_is_left_out_and_drawn_where_nothing_else_is_seen(tmp_path):
    shape = read(write(tmp_path, link(inside=CLEAR)))
    assert [piece.rgba for piece in shape.pieces] == [(1.0, 0.0, 0.0, 1.0)]
    assert any("drawn opaque" in note for note in shape.notes)
    shape = read(write(tmp_path, link(inside=CLEAR, more=HANDLE)))
    np.testing.assert_allclose(size_of(shape), 0.02, atol=1e-3)
    assert "left out, as their alpha is 0: 1 of 2 surfaces" in shape.notes


def test_a_material_of_one_link_holds_in_another():
    shape = read(CASES / "11_urdf_material_reuse")
    assert [piece.rgba for piece in shape.pieces] == [(0.8, 0.0, 0.0, 1.0)] * 2


def test_a_density_in_the_file_is_taken(tmp_path):
    assert read(CASES / "21_urdf_density").density == 2700
    two = [
        link(name, more=f'<inertial><density value="{n}"/></inertial>')
        for name, n in (("a", 1), ("b", 2))
    ]
    joint = '<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>'
    with pytest.raises(AssetError, match=r"densities \[1\.0, 2\.0\]"):
        read(write(tmp_path, "".join(two) + joint))


@pytest.mark.parametrize(
    ("inside", "more", "told"),
    [
        ('<origin xyz="0 1"/>', "", '<origin xyz="0 1">'),
        ('<origin xyz="0 1 nan"/>', "", '<origin xyz="0 1 nan">'),
        ('<origin rpy="1.57"/>', "", '<origin rpy="1.57">'),
        ('<material name="m"><color rgba="1 0"/></material>', "", '<color rgba="1 0">'),
        ('<material name="m"><color/></material>', "", "<color> without the attribute 'rgba'"),
        ("", '<inertial><mass value="1 2"/></inertial>', '<mass value="1 2">'),
        ("", '<inertial><mass value="1"/><origin xyz="1"/></inertial>', '<origin xyz="1">'),
        ("", '<inertial><mass value="1"/><inertia ixx="1 2"/></inertial>', '<inertia ixx="1 2">'),
        ("", '<inertial><density value="-1"/></inertial>', '<density value="-1">'),
    ],
)
def test_wrong_numbers_of_a_link_name_file_element_and_attribute(tmp_path, inside, more, told):
    with pytest.raises(AssetError) as error:
        read(write(tmp_path, link(inside=inside, more=more)))
    assert "thing.urdf" in str(error.value)
    assert told in str(error.value)


def fingers(second, axis="0 0 1"):
    """Two links that slide along z from the base: the first from 2 cm on, the second as its joint says."""
    first = '<joint name="f1" type="prismatic"><parent link="base"/><child link="a"/>'
    first += f'<axis xyz="{axis}"/><limit lower="0.02" upper="0.04"/></joint>'
    other = '<joint name="f2" type="prismatic"><parent link="base"/><child link="b"/>'
    other += f'<axis xyz="0 0 1"/>{second}'
    return '<link name="base"/>' + link("a") + link("b") + first + other + "</joint>"


def heights(shape):
    return [round(float(piece.mesh.bounds.mean(0)[2]), 6) for piece in shape.pieces]


def test_a_joint_that_mimics_another_follows_it(tmp_path):
    shape = read(write(tmp_path, fingers('<mimic joint="f1"/>')))
    assert heights(shape) == [0.02, 0.02]
    shape = read(write(tmp_path, fingers('<mimic joint="f1" multiplier="-2" offset="0.01"/>')))
    assert heights(shape) == [0.02, -0.03]
    assert "'f2' (prismatic) at -0.03 m" in shape.notes[0]


def joint(name, parent, child):
    return f'<joint name="{name}" type="fixed"><parent link="{parent}"/><child link="{child}"/></joint>'


@pytest.mark.parametrize(
    ("joints", "told"),
    [
        (link("a"), "two <link> are called 'a'"),
        (joint("j", "a", "b") + joint("j", "a", "c"), "two <joint> are called 'j'"),
        (
            joint("j", "a", "c") + joint("k", "b", "c"),
            "link 'c' is the child of joints 'j' and 'k'",
        ),
        (
            joint("j", "a", "d"),
            "joint 'j' has the child 'd', which is no link. Allowed: 'a', 'b', 'c'",
        ),
        (joint("j", "d", "a"), "joint 'j' has the parent 'd', which is no link"),
    ],
)
def test_what_is_no_tree_of_links_is_refused(tmp_path, joints, told):
    with pytest.raises(AssetError, match=re.escape(told)):
        read(write(tmp_path, link("a") + link("b") + link("c") + joints))


def test_degrees_are_told_from_radians(tmp_path):
    shape = read(write(tmp_path, link(inside='<origin rpy="0 0 90"/>')))
    assert any('rpy="0 0 90" is read as radians' in note for note in shape.notes)
    whole_turn = read(write(tmp_path, link(inside='<origin rpy="0 0 6.2832"/>')))
    assert not any("radians" in note for note in whole_turn.notes)
