"""A bank inside another model: its specification, and states in which scenes stand whatever else is there."""

import jax
import mujoco
import numpy as np
import pytest

import cluttergen_jax as cg
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import product, transform_points
from tests.helpers.placing import write_bank

ROOM = """<mujoco><option timestep="0.002"/><worldbody><body name="slider"><joint name="rail" type="slide"/>
<geom size="0.1" pos="0 0 5"/></body></worldbody><actuator><position name="drive" joint="rail"/></actuator>
<keyframe><key name="own" qpos="0.5" ctrl="0.5"/></keyframe></mujoco>"""
PLACE = (1.0, -2.0, 0.25)
TURN = (np.cos(0.3), 0.0, 0.0, np.sin(0.3))


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    return cg.load_bank(write_bank(tmp_path_factory.mktemp("world") / "bank").path)


@pytest.fixture(scope="module")
def world(bank):
    """The bank in a room, moved, with a body after it, too: its joints are neither first nor last."""
    spec = mujoco.MjSpec.from_string(ROOM)
    attached = bank.attach_to(spec, "clutter-", position=PLACE, quaternion=TURN)
    spec.worldbody.add_body(name="last", pos=(0, 9, 9)).add_freejoint(name="last")
    spec.body("last").add_geom(size=(0.1, 0, 0))
    return attached.world(spec.compile())


def test_a_specification_holds_every_object_once_and_no_keyframe(bank):
    model = bank.to_mjspec().compile()
    assert model.nkey == 0
    assert model.nq == 7 * len(bank.names)
    for name in bank.names:
        assert model.body(name).mass == pytest.approx(bank.model().body(name).mass)
        assert model.body(name).pos[0] > 10


def test_states_are_the_scenes_by_name_wherever_they_were_attached(bank, world):
    scenes = {scene.origin.index: scene for scene in cg.read_scenes(bank.bank)}
    frame = np.array([*PLACE, *TURN])
    for index, scene in scenes.items():
        state = world.reset(0, index=index)
        for name, pose in zip(scene.names, scene.poses, strict=True):
            first = world.model.joint(f"clutter-{name}").qposadr[0]
            np.testing.assert_allclose(
                state.qpos[first:][:3], transform_points(frame, pose[:3]), atol=1e-6
            )
            turn = state.qpos[first:][3:7] @ product(frame[3:], pose[3:])
            assert abs(turn) == pytest.approx(1, abs=1e-6)
        assert state.qpos[world.model.joint("last").qposadr[0] + 1] == 9
        assert state.ctrl.shape == (1,)


def test_what_a_scene_lacks_waits_and_the_rest_stays_at_rest(bank, world):
    state = world.reset(1)
    # Only the first object is there: the others are to be held.
    is_present = np.arange(len(bank.names)) == 0
    scene = bank.scene(0).replace(is_present=is_present)
    held = np.asarray(world._state(scene, jax.random.key(0)).xfrc_applied)
    masses = world.model.body_mass[world.bodies]
    np.testing.assert_allclose(
        held[world.bodies, 2], np.where(is_present, 0, 9.81 * masses), rtol=1e-5
    )
    assert not np.delete(held, world.bodies, axis=0).any()
    data = mujoco.MjData(world.model)
    world.put(data, state)
    assert data.time == 0
    assert not data.qvel.any()
    start = data.qpos[world.object_qpos]
    mujoco.mj_step(world.model, data, 100)
    assert np.abs(data.qpos[world.object_qpos] - start)[:, :3].max() < 1e-3


def test_what_waits_is_held_by_the_gravity_of_the_model_that_a_bank_is_attached_to(bank):
    spec = mujoco.MjSpec.from_string(ROOM)
    spec.option.gravity = (0.5, 0.0, -3.0)
    attached = bank.attach_to(spec, "clutter-")
    world = attached.world(spec.compile())
    nobody = bank.scene(0).replace(is_present=np.zeros(len(bank.names), bool))
    held = np.asarray(world._state(nobody, jax.random.key(0)).xfrc_applied)
    masses = world.model.body_mass[world.bodies, None]
    np.testing.assert_allclose(held[world.bodies, :3], masses * [-0.5, 0, 3], rtol=1e-5)


def test_fields_of_an_episode_are_undone_by_the_next_one(world):
    own = world.model.geom_friction.copy()
    state = world.reset(0)
    data = mujoco.MjData(world.model)
    world.put(data, state.replace(fields={"geom_friction": 0.5 * own}))
    np.testing.assert_array_equal(world.model.geom_friction, 0.5 * own)
    np.testing.assert_array_equal(world.own_field("geom_friction"), own)
    world.put(data, state)
    np.testing.assert_array_equal(world.model.geom_friction, own)


def test_equal_seeds_and_keys_give_equal_states(world):
    one = world.reset(5)
    again = world.reset(5)
    keyed = world.reset(cg.generation.bank_world.new_key(5))
    np.testing.assert_array_equal(one.qpos, again.qpos)
    np.testing.assert_array_equal(one.qpos, np.asarray(keyed.qpos))


@pytest.mark.slow
def test_keys_are_mapped_to_scenes(world):
    many = jax.jit(jax.vmap(world.reset))(jax.random.split(jax.random.key(0), 32))
    assert many.qpos.shape == (32, world.model.nq)
    assert len(set(np.asarray(many.index).tolist())) > 1


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda world: world.reset(-1), "seed=-1"),
        (lambda world: world.reset(True), "one key"),
        (lambda world: world.reset(0, index=99), "scene 99"),
        (lambda world: world.reset(jax.random.split(jax.random.key(0))), "vmap"),
    ],
)
def test_seeds_that_are_none_are_refused(world, call, told):
    with pytest.raises(ConfigError, match=told):
        call(world)


def test_what_belongs_to_another_model_is_refused(bank, world):
    data = mujoco.MjData(world.model)
    state = world.reset(0)
    many = jax.vmap(world.reset)(jax.random.split(jax.random.key(0), 3))
    with pytest.raises(ConfigError, match=r"state with qpos of shape \(3, .*of a batch one state"):
        world.put(data, many)
    with pytest.raises(ConfigError, match="data with qpos of shape"):
        world.put(mujoco.MjData(bank.model()), state)
    with pytest.raises(ConfigError, match="put into a NoneType"):
        world.put(None, state)
    world.put(data, jax.tree.map(lambda each: each[0], many))
    with pytest.raises(ConfigError, match=r"spec.compile\(\)"):
        world.attachment.world(bank.to_mjspec())
    with pytest.raises(ConfigError, match="attach_to a MjModel"):
        bank.attach_to(bank.model())
    for index in ("0", True, 99):
        with pytest.raises(ConfigError, match=f"scene {index!r} of"):
            world.reset(0, index=index)


def test_a_model_keeps_its_own_detector_without_a_warning(bank, recwarn):
    spec = mujoco.MjSpec()
    bank.attach_to(spec)
    assert not spec.compile().opt.disableflags
    assert not recwarn.list
