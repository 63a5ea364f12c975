"""Exported scenes in dm_control: an arena with a scene in it, to which a task adds what it likes.

    from cluttergen_dm_control import ClutterArena     # needs dm_control 1.0.50 and MuJoCo 3.17

    arena = ClutterArena(scene=3)                      # without a number another scene in each episode
    arena.attach(robot)
    env = composer.Environment(task)                   # a task whose root_entity is the arena

`add_scene(arena, 3)` does the same for an arena of your own: the support is attached, and each object is an
entity with a free joint that the arena gives it (`arena.add_free_entity`). Their poses are the model's own:
every reset of the physics puts them back.
"""

# ruff: noqa: E402
import copy
import xml.etree.ElementTree as ET
from pathlib import Path

from host_checks import check_versions, scene_number

ROOT = Path(__file__).resolve().parent
KNOWN = {"dm_control": ("1.0.50",), "mujoco": ("3.17.",)}
"""How the versions begin that this was run with."""
check_versions(KNOWN, "dm_control==1.0.50 mujoco==3.17.0", ("dm_control", "mujoco"))

from dm_control import composer, mjcf
from dm_control.locomotion.arenas import floors


def scene_numbers():
    """The numbers of all scenes in the folder."""
    return sorted(int(path.stem) for path in (ROOT / "scenes").glob("*.xml"))


class SceneFile:
    """A scene's MJCF, cut into its bodies.

    Args:
      number: the scene's.

    Attributes:
      poses: (name, position, quaternion wxyz) of every object, world frame, metres.
    """

    def __init__(self, number):
        number = scene_number(number, scene_numbers(), ROOT)
        self._root = ET.parse(ROOT / "scenes" / f"{number:06d}.xml").getroot()
        if self._root.find("contact") is not None:
            raise ValueError(
                f"scene {number} has a support whose joints move, which cannot be attached; "
                "export it without them"
            )
        self._bodies = {each.get("name"): each for each in self._root.iterfind("worldbody/body")}
        self._assets = list(self._root.find("asset"))
        self.poses = [
            (name, _numbers(body, "pos", "0 0 0"), _numbers(body, "quat", "1 0 0 0"))
            for name, body in self._bodies.items()
            if body.find("freejoint") is not None
        ]

    def model(self, name):
        """The `mjcf.RootElement` of one body at the origin: an object, or "support"."""
        body = copy.deepcopy(self._bodies[name])
        for attribute in ("pos", "quat") if body.find("freejoint") is not None else ():
            body.attrib.pop(attribute, None)
        for joint in body.findall("freejoint"):
            body.remove(joint)
        body.set("name", "object")
        root = ET.Element("mujoco", model=name)
        root.append(self._root.find("default"))
        root.append(self._assets_of(body))
        ET.SubElement(root, "worldbody").append(body)
        folder = ROOT / "assets"
        ET.SubElement(root, "compiler", meshdir=str(folder), texturedir=str(folder))
        return mjcf.from_xml_string(ET.tostring(root, encoding="unicode"), model_dir=str(folder))

    def set_options(self, model):
        """Gives a model the time step and the contacts' options that the scenes were checked with."""
        option = self._root.find("option")
        given = {**option.attrib, **{f"flag.{k}": v for k, v in option.find("flag").items()}}
        for key, value in given.items():
            place = model.option.flag if key.startswith("flag.") else model.option
            words = value.split()
            try:
                found = [float(each) for each in words]
            except ValueError:
                found = words
            setattr(place, key.removeprefix("flag."), found[0] if len(found) == 1 else found)

    def _assets_of(self, body):
        """What the shapes of a body refer to: meshes, materials, and the textures of these."""
        used = {geom.get(key) for geom in body.iter("geom") for key in ("mesh", "material")}
        for each in self._assets:
            if each.tag == "material" and each.get("name") in used:
                used |= {each.get("texture"), *(layer.get("texture") for layer in each)}
        found = ET.Element("asset")
        found.extend(each for each in self._assets if each.get("name") in used)
        return found


class ClutterObject(composer.Entity):
    """One object; the arena gives it a free joint.

    Args:
      file: the `SceneFile`.
      name: the object's.
    """

    def _build(self, file, name):
        self._model = file.model(name)

    @property
    def mjcf_model(self):
        """Its tree of elements."""
        return self._model


def add_scene(arena, number):
    """Adds the support and the objects of a scene to an arena, which need be empty above its floor.

    Args:
      arena: a `composer.Arena`; it is given the scene's time step and options of contacts.
      number: the scene's.

    Returns:
      The objects by name, `ClutterObject`: `object.get_pose(physics)`. The support is "support".
    """
    file = SceneFile(number)
    file.set_options(arena.mjcf_model)
    added = {"support": ClutterObject(file, "support")}
    arena.attach(added["support"])
    for name, position, quaternion in file.poses:
        added[name] = ClutterObject(file, name)
        frame = arena.add_free_entity(added[name])
        frame.pos = position
        frame.quat = quaternion
    return added


class ClutterArena(floors.Floor):
    """dm_control's floor with a scene on it.

    Args:
      scene: its number; a scene is drawn for each episode if it is not given.
      size: half lengths of the floor, metres.
      kwargs: of `floors.Floor`.

    Attributes:
      objects: what `add_scene` returned for the scene that is there. scene: its number.
    """

    def _build(self, scene=None, size=(4, 4), **kwargs):
        super()._build(size=size, **kwargs)
        self._is_drawn = scene is None
        self.objects = {}
        self.show(scene_numbers()[0] if scene is None else scene)

    def show(self, scene):
        """Puts another scene in place of the one that is there; the physics is to be compiled anew."""
        scene = scene_number(scene, scene_numbers(), ROOT)
        for each in self.objects.values():
            each.detach()
        self.objects = add_scene(self, scene)
        self.scene = scene

    def initialize_episode_mjcf(self, random_state):
        """Draws the scene of an episode."""
        super().initialize_episode_mjcf(random_state)
        if self._is_drawn:
            self.show(int(random_state.choice(scene_numbers())))


def _numbers(element, key, usual):
    return [float(each) for each in element.get(key, usual).split()]
