"""Reads a bank with the reader beside it, in an environment of pyarrow, some MuJoCo and perhaps some JAX.

python read_bank.py BANK
"""

import importlib.util
import sys

import mujoco
import numpy as np

sys.path.insert(0, sys.argv[1])
from bank_reader import Bank

SECONDS = 2.0
MAX_SHIFT = 0.005
NUM_RESETS = 256


def shift(model, qpos, applied=None):
    """Metres, the farthest that anything is from where it began, after some seconds of simulation."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    if applied is not None:
        data.xfrc_applied[2:] = applied
    for _ in range(round(SECONDS / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return np.linalg.norm((data.qpos - qpos).reshape(-1, 7)[:, :3], axis=1).max()


bank = Bank(sys.argv[1])
shifts = []
for scene in bank.successes():
    model = bank.model(scene.index)
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "scene")
    np.testing.assert_allclose(model.key_qpos[key], scene.qpos, atol=1e-6)
    shifts.append(shift(model, scene.qpos))
together = bank.model()
arrays = bank.arrays
one = type(arrays)(*(each[0] for each in arrays))
shifts.append(shift(together, *bank.state(one)))
assert max(shifts) < MAX_SHIFT, shifts
words = [
    f"{len(shifts)} models of {len(bank)} scenes moved by {1e3 * max(shifts):.2f} mm at most in {SECONDS:g} s"
]
words += [f"in MuJoCo {mujoco.__version__}"]
if importlib.util.find_spec("jax"):
    import jax

    keys = jax.random.split(jax.random.key(0), NUM_RESETS)
    scenes = jax.jit(jax.vmap(bank.reset_jax))(keys)
    qpos, applied = jax.jit(jax.vmap(bank.state))(scenes)
    assert qpos.shape == (NUM_RESETS, together.nq)
    assert applied.shape == (NUM_RESETS, together.nbody - 2, 6)
    indices, places = np.unique(np.asarray(scenes.index), return_index=True)
    assert indices.tolist() == arrays.index.tolist()
    for index, place in zip(indices.tolist(), places.tolist()):  # noqa: B905, Python 3.8 has no `strict`
        poses = np.asarray(scenes.poses[place])[np.asarray(scenes.is_placed[place])]
        np.testing.assert_array_equal(poses, bank.scene(index).poses.astype(np.float32))
    assert shift(together, np.asarray(qpos[0]), np.asarray(applied[0])) < MAX_SHIFT
    words.append(f"{NUM_RESETS} resets in JAX {jax.__version__}")
print(", ".join(words))
