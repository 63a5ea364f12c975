"""A scene as a value: inside other models, and many of them in one."""

import mujoco
import numpy as np
import pytest

from cluttergen_jax.assets.support import cuboid_table
from cluttergen_jax.errors import ConfigError
from cluttergen_jax.geometry import turn_between
from cluttergen_jax.scene import collect
from tests.helpers.exports import spread
from tests.helpers.worlds import trio


@pytest.fixture(scope="module")
def scene():
    return spread(trio(), cuboid_table())


def arm(timestep=0.002):
    """A small robot: two hinges on a pedestal, with a keyframe of its own and MuJoCo's own defaults."""
    spec = mujoco.MjSpec()
    spec.option.timestep = timestep
    base = spec.worldbody.add_body(name="base", pos=(-0.6, 0, 0.7))
    base.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.05, 0.05, 0.05))
    upper = base.add_body(name="upper", pos=(0, 0, 0.1))
    upper.add_joint(name="shoulder", type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, 0, 1), damping=5)
    upper.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=(0, 0, 0, 0, 0, 0.3), size=(0.02, 0, 0)
    )
    fore = upper.add_body(name="fore", pos=(0, 0, 0.3))
    fore.add_joint(name="elbow", type=mujoco.mjtJoint.mjJNT_HINGE, axis=(0, 1, 0), damping=5)
    fore.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=(0, 0, 0, -0.2, 0, 0), size=(0.02, 0, 0)
    )
    spec.add_key(name="home", qpos=[0.3, -0.2])
    return spec


def moved(model, data, bodies, seconds=2.0):
    """The farthest that any of these bodies moves, metres."""
    mujoco.mj_forward(model, data)
    start = np.array([data.body(name).xpos for name in bodies])
    mujoco.mj_step(model, data, nstep=round(seconds / model.opt.timestep))
    return np.linalg.norm(np.array([data.body(name).xpos for name in bodies]) - start, axis=1).max()


@pytest.mark.parametrize("prefix", ["", "clutter/"])
def test_alone_it_is_the_scene(scene, prefix):
    model = scene.to_mjspec(prefix).compile()
    assert model.opt.timestep == scene.stability.file_timestep
    np.testing.assert_allclose(model.key(prefix + "scene").qpos, scene.poses.ravel())
    np.testing.assert_allclose(model.qpos0, scene.poses.ravel())
    assert {model.body(i).name for i in model.jnt_bodyid} == {prefix + name for name in scene.names}
    data = mujoco.MjData(model)
    assert moved(model, data, [prefix + name for name in scene.names]) < 1e-4


def test_beside_a_robot_poses_names_and_options_are_what_they_were(scene):
    spec = arm()
    attachment = scene.attach_to(spec, "clutter/")
    model = spec.compile()
    assert model.opt.timestep == 0.002
    assert model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(attachment.keyframe).id)
    mujoco.mj_forward(model, data)
    for name, pose in zip(scene.names, scene.poses, strict=True):
        np.testing.assert_allclose(data.body("clutter/" + name).xpos, pose[:3], atol=1e-12)
        assert turn_between(np, data.body("clutter/" + name).xquat, pose[3:]) < 1e-7
    # The robot's own keyframe keeps its joints and has the scene beside them.
    np.testing.assert_allclose(model.key("home").qpos[:2], [0.3, -0.2])
    np.testing.assert_allclose(model.key("home").qpos[2:], scene.poses.ravel())
    np.testing.assert_allclose(
        attachment.qpos(model, model.key("home").qpos), model.key("home").qpos
    )
    for geom in range(model.ngeom):
        if model.geom(geom).name.startswith("clutter/"):
            np.testing.assert_allclose(model.geom_friction[geom], scene.contact.friction)
            np.testing.assert_allclose(model.geom_solref[geom], scene.contact.solref)
    assert moved(model, data, attachment.bodies) < 5e-4


def test_a_name_that_is_taken_and_a_bad_turn_are_refused(scene):
    spec = arm()
    scene.attach_to(spec, "clutter/")
    with pytest.raises(ConfigError, match="another prefix"):
        scene.attach_to(spec, "clutter/")
    with pytest.raises(ConfigError, match="unit length"):
        scene.attach_to(spec, "other/", quaternion=(2, 0, 0, 0))


def test_many_scenes_are_one_model_and_stand_in_it():
    one, two, three = trio()
    scenes = [
        spread([one, two], cuboid_table()),
        spread([three, one, one], cuboid_table(), names=("tall", "box", "box#2"), turn=0.2),
        spread([two, three], cuboid_table(), turn=1.1),
    ]
    many = collect(scenes)
    assert sorted(many.names) == ["box", "box#2", "prism", "tall"]
    np.testing.assert_array_equal(many.is_present.sum(1), [2, 3, 2])
    assert many.qpos.shape == (3, many.model.nq)
    data = mujoco.MjData(many.model)
    for row, scene in enumerate(scenes):
        many.reset(data, row)
        start = data.qpos.reshape(-1, 7).copy()
        for asset, pose, index in zip(
            scene.objects, scene.poses, many.object_index[row], strict=False
        ):
            assert many.objects[index].name == asset.name
            np.testing.assert_allclose(start[index], pose)
        mujoco.mj_step(many.model, data, nstep=480)
        shift = np.linalg.norm(data.qpos.reshape(-1, 7)[:, :3] - start[:, :3], axis=1)
        assert shift[many.is_present[row]].max() < 1e-4
        # Who is not there neither falls nor touches anything, not even the others who are not there.
        assert shift[~many.is_present[row]].max() < 1e-9
        absent = set(many.model.jnt_bodyid[~many.is_present[row]])
        bodies = many.model.geom_bodyid[data.contact.geom]
        assert not absent & set(bodies.ravel())
