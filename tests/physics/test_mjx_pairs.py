"""One collision function for all pairs: the contacts that MJX itself finds, and no silent loss of any."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import trimesh
from mujoco import mjx

from cluttergen_jax.physics.mjx_pairs import ConvexPairs, faces_first

SHAPES = {
    "cone": trimesh.creation.cone(0.03, 0.06, sections=9),
    "prism": trimesh.creation.cylinder(0.03, 0.05, sections=6),
    "ball": trimesh.creation.icosphere(1, 0.03),
}


@pytest.fixture(scope="module")
def model():
    """Three parts of different sizes over a table that is a box."""
    spec = mujoco.MjSpec()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.3, 0.3, 0.02), condim=4)
    for name, shape in SHAPES.items():
        spec.add_mesh(name=name, uservert=np.asarray(shape.vertices, np.float32).ravel())
        body = spec.worldbody.add_body(name=name)
        body.add_freejoint()
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, condim=4, friction=(0.5, 0.005, 1e-4)
        )
    # As an object with a friction of its own, less than that of what it touches.
    slippery = spec.body("ball").first_geom()
    slippery.priority = 9
    slippery.friction = (0.1, 0.001, 1e-5)
    return spec.compile()


@pytest.fixture(scope="module")
def on_device(model):
    return mjx.put_model(model, impl="jax")


def scenes(model, pairs, number=24):
    """Parts near one another and the table, turned at random."""
    rng = np.random.default_rng(0)
    with pairs.replacing_mjx():
        blank = mjx.make_data(model, impl="jax")
    poses = rng.normal(size=(number, 3, 7))
    poses[..., :3] = rng.uniform((-0.03, -0.03, 0.03), (0.03, 0.03, 0.09), (number, 3, 3))
    poses[..., 3:] /= np.linalg.norm(poses[..., 3:], axis=-1, keepdims=True)
    qpos = jnp.asarray(poses.reshape(number, -1), jnp.float32)
    return jax.vmap(lambda each: blank.replace(qpos=each))(qpos)


def depths(data):
    """f64[scenes, 4, 4]: the deepest contact of each pair of geoms, metres."""
    contact = jax.device_get(data._impl.contact)
    found = np.zeros((len(contact.dist), 4, 4))
    pair = np.sort(contact.geom, axis=-1)
    rows = np.arange(len(found))[:, None]
    np.maximum.at(found, (rows, pair[..., 0], pair[..., 1]), np.maximum(-contact.dist, 0))
    return found


def frictions(data):
    """f64[scenes, 4, 4]: the sliding friction of each pair of geoms that touch, 0 of others."""
    contact = jax.device_get(data._impl.contact)
    found = np.zeros((len(contact.dist), 4, 4))
    rows, place = np.nonzero(contact.dist < 0)
    pair = np.sort(contact.geom[rows, place], axis=-1)
    found[rows, pair[:, 0], pair[:, 1]] = contact.friction[rows, place, 0]
    return found


@pytest.mark.slow
def test_the_contacts_are_those_of_mjx(model, on_device):
    pairs = ConvexPairs(model, on_device, 3)
    data = scenes(model, pairs)
    ours = jax.vmap(lambda each: pairs.find_contacts(on_device, mjx.kinematics(on_device, each)))(
        data
    )
    own = jax.vmap(lambda qpos: mjx.make_data(model, impl="jax").replace(qpos=qpos))(data.qpos)
    with faces_first():
        theirs = jax.vmap(lambda each: mjx.collision(on_device, mjx.kinematics(on_device, each)))(
            own
        )
    assert (depths(theirs) > 0).sum() > 40
    np.testing.assert_allclose(depths(ours), depths(theirs), atol=2e-6)
    touch = (depths(theirs) > 1e-5) & (depths(ours) > 1e-5)
    np.testing.assert_allclose(frictions(ours)[touch], frictions(theirs)[touch], rtol=1e-6)
    assert {round(float(each), 2) for each in frictions(ours)[touch]} == {0.1, 0.5, 1.0}
    assert not jax.vmap(lambda each: pairs.has_overflowed(on_device, each))(ours).any()


@pytest.mark.slow
def test_more_pairs_than_are_looked_at_are_told(model, on_device, monkeypatch):
    monkeypatch.setattr("cluttergen_jax.physics.mjx_pairs._NEAR_PAIRS", 1)
    pairs = ConvexPairs(model, on_device, 3)
    data = scenes(model, pairs)
    apart = (
        data.qpos.reshape(-1, 3, 7)
        .at[:, :, 0]
        .add(jnp.array([-0.2, 0.0, 0.2]))
        .reshape(len(data.qpos), -1)
    )
    told = []
    for qpos in (data.qpos, apart):
        placed = jax.vmap(lambda each: mjx.kinematics(on_device, each))(data.replace(qpos=qpos))
        found = jax.vmap(lambda each: pairs.find_contacts(on_device, each))(placed)
        assert found._impl.contact.dist.shape[1] == 4 * 3
        told.append(np.asarray(jax.vmap(lambda each: pairs.has_overflowed(on_device, each))(found)))
    assert told[0].mean() > 0.9
    assert not told[1].any()
