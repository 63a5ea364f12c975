"""MoveIt's text files, read here by the rules of its own reader, which no package index has.

`Reader` follows what `PlanningScene::loadGeometryFromStream` (moveit_core) and `constructShapeFromText`
(geometric_shapes) take from a stream: a name's line, then words divided by blanks.
"""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest

from cluttergen_jax.assets.support_file import find_support
from cluttergen_jax.scene.export import export_scenes
from tests.helpers.exports import assert_same_pose, spread
from tests.helpers.worlds import trio


@dataclass
class Shape:
    """A box of three sides, or a mesh; pose xyz, xyzw in its object's frame."""

    sides: np.ndarray | None
    vertices: np.ndarray | None
    faces: np.ndarray | None
    pose: np.ndarray


class Reader:
    """Takes a file apart, or fails where MoveIt would."""

    def __init__(self, text):
        self.name, _, rest = text.partition("\n")
        head, _, rest_of_first = rest.partition("\n")
        assert head.startswith("* ")
        # The line after the first object's name decides the form: blanks in it are those of a position.
        assert " " in rest_of_first.partition("\n")[0].strip()
        self._rest = rest

    def word(self):
        word, _, self._rest = self._rest.lstrip().partition(" ")
        if "\n" in word:
            word, _, more = word.partition("\n")
            self._rest = f"{more} {self._rest}"
        return word

    def numbers(self, count, kind=float):
        return np.array([kind(self.word()) for _ in range(count)])

    def shape(self):
        kind = self.word()
        sides = vertices = faces = None
        if kind == "box":
            sides = self.numbers(3)
        else:
            assert kind == "mesh"
            num_vertices, num_faces = self.numbers(2, int)
            vertices = self.numbers(3 * num_vertices).reshape(-1, 3)
            faces = self.numbers(3 * num_faces, int).reshape(-1, 3)
        shape = Shape(sides, vertices, faces, self.numbers(7))
        colour = self.numbers(4)
        assert (colour >= 0).all()
        assert (colour <= 1).all()
        return shape

    def objects(self):
        """By name: T_world_object, xyz and xyzw, and the shapes."""
        found = {}
        while (marker := self.word()) == "*":
            line, _, self._rest = self._rest.partition("\n")
            assert line.strip() not in found
            pose = self.numbers(7)
            found[line.strip()] = pose, [self.shape() for _ in range(int(self.word()))]
            # Subframes.
            assert int(self.word()) == 0
        assert marker == "."
        assert not self._rest.strip()
        return found


def test_what_is_read_is_what_collides(folder_of, scene):
    reader = Reader((folder_of("moveit") / "scenes" / "000000.scene").read_text())
    objects = reader.objects()
    assert reader.name == "bank 0"
    assert list(objects) == ["support", *scene.names]
    for name, asset, pose in zip(scene.names, scene.objects, scene.poses, strict=True):
        at, shapes = objects[name]
        assert_same_pose(at[:3], at[[6, 3, 4, 5]], pose)
        assert len(shapes) == len(asset.parts)
        for shape, part in zip(shapes, asset.parts, strict=True):
            np.testing.assert_allclose(shape.vertices, part.vertices, rtol=1e-7, atol=1e-9)
            corners = shape.vertices[shape.faces]
            # Closed and outwards: the volume by its triangles is that of the convex part.
            volume = np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
            assert volume.sum() / 6 > 0


@pytest.mark.parametrize("support", ["tilted_board_10", "round_table"])
def test_a_support_is_where_mujoco_has_it(tmp_path, support):
    """By the boxes that hold each solid in the world, of both."""
    scene = spread(trio()[:1], find_support(support))
    folder = export_scenes([scene], tmp_path / "out", "moveit")
    at, shapes = Reader((folder / "scenes/000000.scene").read_text()).objects()["support"]
    np.testing.assert_allclose(at, [0, 0, 0, 0, 0, 0, 1])
    told = []
    for shape in shapes:
        points = shape.vertices
        if shape.sides is not None:
            signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
            points = signs * shape.sides / 2
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, shape.pose[[6, 3, 4, 5]])
        points = points @ turn.reshape(3, 3).T + shape.pose[:3]
        told.append([points.min(0), points.max(0)])
    model = scene.to_mjspec().compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    own = []
    for geom in np.flatnonzero(
        (model.geom_contype > 0) & (model.geom_bodyid == model.body("support").id)
    ):
        turn = data.geom_xmat[geom].reshape(3, 3)
        middle = data.geom_xpos[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
            half = np.abs(turn) @ model.geom_size[geom]
            own.append([middle - half, middle + half])
        else:
            mesh = model.mesh(model.geom_dataid[geom])
            first = int(mesh.vertadr[0])
            points = model.mesh_vert[first : first + int(mesh.vertnum[0])] @ turn.T + middle
            own.append([points.min(0), points.max(0)])
    assert len(told) == len(own) == len(scene.support.boxes) + len(scene.support.parts)
    order = [np.lexsort(np.round(np.array(each).reshape(-1, 6), 4).T) for each in (told, own)]
    np.testing.assert_allclose(np.array(told)[order[0]], np.array(own)[order[1]], atol=1e-5)


def test_an_object_called_support_has_its_name(tmp_path):
    scene = spread(trio()[:1], find_support("table"), ("support",))
    scene = replace(scene, origin=replace(scene.origin, bank="two\nlines"))
    folder = export_scenes([scene], tmp_path / "out", "moveit")
    reader = Reader((folder / "scenes/000000.scene").read_text())
    assert reader.name == "two lines 0"
    assert list(reader.objects()) == ["support_", "support"]
