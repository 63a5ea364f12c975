"""Relations and forces of scenes built by hand, real objects among them."""

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cluttergen_jax.assets.pool import find_pool
from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.config import ContactConfig, StabilityConfig
from cluttergen_jax.judging.scene_models import SceneModels, contacts_of
from cluttergen_jax.placement.world import make_world
from studies.measures.relations import (
    Relation,
    carried_by,
    relations,
    tilt_from_rest,
    vessel_of,
)
from tests.helpers.worlds import TOP

GRAVITY = 9.81
NAMES = (
    "mug",
    "hardback_book",
    "fork",
    "dinner_plate",
    "wooden_spoon",
    "bowl",
    "water_glass",
    "soup_can",
)
POOLS = {"hardback_book": "study", "wooden_spoon": "kitchen"}
SUPPORT = len(NAMES)

# Position above the table's top and degrees about y, then about z; each scene is left to settle.
SCENES = {
    "mug on book": {"hardback_book": (0, 0, 0.017), "mug": (0, 0, 0.077)},
    "fork under the plate's rim": {"fork": (0.11, 0, 0.006, 0, 90), "dinner_plate": (0, 0, 0.012)},
    "plate on fork": {"fork": (0, 0, 0.006), "dinner_plate": (0, 0, 0.024)},
    "spoon in bowl": {"bowl": (0, 0, 0.033), "wooden_spoon": (-0.07, 0, 0.1, 35)},
    "spoon against bowl": {"bowl": (0, 0, 0.033), "wooden_spoon": (0.05, 0, 0.1, 30)},
    "fork in glass": {"water_glass": (0, 0, 0.061), "fork": (0, 0, 0.112, 80)},
    "can in bowl": {"bowl": (0, 0, 0.033), "soup_can": (0, 0, 0.075)},
    "book against mug": {"mug": (0, 0, 0.049), "hardback_book": (-0.1, 0, 0.075, -40)},
    "fork across the rim": {"dinner_plate": (0, 0, 0.012), "fork": (0.13, 0, 0.035, 10)},
    "side by side": {"mug": (0, 0, 0.048), "soup_can": (0.15, 0, 0.051)},
}


@pytest.fixture(scope="module")
def models():
    pools = {name: find_pool(name) for name in {"dining", *POOLS.values()}}
    objects = [pools[POOLS.get(name, "dining")][name] for name in NAMES]
    return SceneModels(make_world(objects, cuboid_table(), StabilityConfig(), ContactConfig()))


def settled(models, placed, seconds=20.0):
    """The poses f64[K, 7] and mask bool[K] of one scene after it has come to rest."""
    poses = np.tile(np.eye(7)[3], (len(NAMES), 1))
    is_placed = np.zeros(len(NAMES), bool)
    for name, (x, y, z, *degrees) in placed.items():
        k = NAMES.index(name)
        tilt, yaw = (*degrees, 0, 0)[:2]
        turn = Rotation.from_euler("yz", [tilt, yaw], degrees=True).as_quat()
        poses[k] = (x, y, z + TOP, *turn[[3, 0, 1, 2]])
        is_placed[k] = True
    model = models.of(is_placed)
    data = model.start(poses)
    mujoco.mj_step(model.model, data, 240)
    while np.abs(data.qvel).max() > 0.002:
        mujoco.mj_step(model.model, data, 24)
        assert data.time < seconds, placed
    poses[model.objects] = data.qpos.reshape(-1, 7).astype(np.float32)
    return poses, is_placed


@pytest.fixture(scope="module")
def scenes(models):
    pairs = [settled(models, placed) for placed in SCENES.values()]
    return np.stack([poses for poses, _ in pairs]), np.stack([mask for _, mask in pairs])


@pytest.fixture(scope="module")
def found(models, scenes):
    return relations(models, *scenes, num_threads=1)


def between(found, scene, i, j):
    """The relation of i to j in the scene of that title."""
    row = list(SCENES).index(scene)
    index = [*NAMES, "support"].index
    return Relation(int(found[row, index(i), index(j)]))


@pytest.mark.parametrize(
    ("scene", "i", "relation", "j"),
    [
        ("mug on book", "mug", Relation.ON, "hardback_book"),
        ("mug on book", "mug", Relation.NONE, "support"),
        ("mug on book", "hardback_book", Relation.ON, "support"),
        ("mug on book", "hardback_book", Relation.NONE, "mug"),
        ("fork under the plate's rim", "fork", Relation.UNDER, "dinner_plate"),
        ("fork under the plate's rim", "dinner_plate", Relation.ON, "support"),
        ("plate on fork", "dinner_plate", Relation.ON, "fork"),
        ("plate on fork", "fork", Relation.NONE, "dinner_plate"),
        ("spoon in bowl", "wooden_spoon", Relation.IN, "bowl"),
        ("spoon in bowl", "wooden_spoon", Relation.NONE, "support"),
        ("spoon against bowl", "wooden_spoon", Relation.LEANING, "bowl"),
        ("spoon against bowl", "wooden_spoon", Relation.ON, "support"),
        ("fork in glass", "fork", Relation.IN, "water_glass"),
        ("can in bowl", "soup_can", Relation.IN, "bowl"),
        ("can in bowl", "bowl", Relation.NONE, "soup_can"),
        ("book against mug", "hardback_book", Relation.LEANING, "mug"),
        ("book against mug", "mug", Relation.NONE, "hardback_book"),
        ("fork across the rim", "fork", Relation.ON, "dinner_plate"),
        ("side by side", "mug", Relation.NONE, "soup_can"),
        ("side by side", "soup_can", Relation.NONE, "mug"),
    ],
)
def test_relation(found, scene, i, relation, j):
    assert between(found, scene, i, j) == relation


def test_forces_balance_weights(models, scenes):
    contacts = contacts_of(models, *scenes, num_threads=1)
    np.testing.assert_allclose(contacts.force.sum(2)[..., :2], 0, atol=0.01)
    np.testing.assert_allclose(contacts.force.sum(2)[..., 2], contacts.weight, atol=0.01)
    # What i does to j, j does to i.
    among = contacts.force[:, :, :SUPPORT]
    np.testing.assert_allclose(among, -np.swapaxes(among, 1, 2), atol=1e-9)
    whole = contacts.weight.sum(1)
    np.testing.assert_allclose(contacts.force[:, :, SUPPORT, 2].sum(1), whole, rtol=1e-2)
    masses = np.array([asset.mass for asset in models.world.objects])
    np.testing.assert_allclose(contacts.weight, masses * GRAVITY * scenes[1])
    assert carried_by(contacts.rests_on)[scenes[1], SUPPORT].all()
    assert (contacts.penetration < 1e-3).all()


def test_tilt_is_measured_from_the_nearest_rest(models):
    can = models.world.objects[NAMES.index("soup_can")]
    for degrees in (0, 7, 20):
        turn = Rotation.from_euler("zy", [80, degrees], degrees=True).as_quat()[[3, 0, 1, 2]]
        assert np.degrees(tilt_from_rest(can, np.r_[0, 0, 0, turn])) == pytest.approx(
            degrees, abs=1e-6
        )
    for rest in can.resting:
        assert tilt_from_rest(can, np.r_[0, 0, 0, rest.quaternion]) < 1e-6


def test_vessels_are_what_holds_something(models):
    vessels = {
        name: vessel_of(asset) for name, asset in zip(NAMES, models.world.objects, strict=True)
    }
    assert {name for name, vessel in vessels.items() if vessel} == {"mug", "bowl", "water_glass"}
    glass = vessels["water_glass"]
    points = np.array([[0, 0, 0], [0, 0, 0.05], [0, 0, 0.07], [0.05, 0, 0], [0, 0, -0.059]])
    assert glass.holds(points).tolist() == [True, True, False, False, False]
