# %% [markdown]
# # A bank as the reset of an environment
# Every episode begins with another verified scene. The task: push a cereal box to the middle of the table by
# a force, and leave the can alone. It is a Brax environment over MJX; PPO trains on it for about a minute.
# Both objects are of one hull, for MJX in pure JAX; with `impl="warp"` on an NVIDIA GPU any will do.

# %%
import time

import flax.linen as nn
import jax
import jax.numpy as jnp
import mujoco
from brax.envs.base import Env, State
from mujoco import mjx

import cluttergen_jax as cg
from cluttergen_jax.learning.networks.distributions import Beta
from cluttergen_jax.learning.ppo.ppo import PPO, PPOConfig

# %%
pair = ("cereal_box", "soup_can")
cg.generate("push_bank", objects=pair, num_scenes=64, method="clear", max_files=0)
bank = cg.load_bank("push_bank")


# %%
class Push(Env):
    """Pushes the cereal box towards the middle of the table."""

    observation_size = 16
    action_size = 2
    backend = "mjx"

    def __init__(self, bank: cg.typing.BankArrays) -> None:
        model = bank.model()
        # Softer contacts and few solver iterations: made for learning, not for verification.
        model.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
        model.opt.iterations = 8
        model.opt.ls_iterations = 8
        model.geom_condim[:] = 3
        model.geom_solimp[:, :2] = (0.9, 0.95)
        self.bank = bank
        self.model = mjx.put_model(model)
        self.blank = mjx.make_data(model)
        box = bank.names.index("cereal_box")
        self.body = int(model.jnt_bodyid[box])
        self.box = 7 * box
        self.can = 7 * (1 - box)
        self.force = 1.5 * float(model.body_mass[self.body]) * 9.81  # newtons, at most

    def reset(self, rng: jax.Array) -> State:
        key_scene, key_next = jax.random.split(rng)
        scene = self.bank.reset(key_scene)
        data = self.blank.replace(qpos=scene.qpos, xfrc_applied=scene.xfrc_applied)
        return self._state(
            data, jnp.float32(0), jnp.float32(0), {"key": key_next, "step": jnp.int32(0)}
        )

    def step(self, state: State, action: jax.Array) -> State:
        before = state.pipeline_state
        push = before.xfrc_applied.at[self.body, :2].set(self.force * (2 * action - 1))
        data = before.replace(xfrc_applied=push)
        data = jax.lax.fori_loop(0, 4, lambda _, d: mjx.step(self.model, d), data)
        (was, can) = self._places(before)
        (now, can_now) = self._places(data)
        progress = jnp.linalg.norm(was) - jnp.linalg.norm(now)
        harm = jnp.linalg.norm(can_now - can)
        # In float32 a hard blow may throw things: whatever is fast or not a number any more has failed too.
        fell = ~((data.qpos[self.box + 2] > 0.7) & (jnp.abs(data.qvel).max() < 30))
        reward = jnp.where(fell, -1.0, jnp.clip(10 * progress - 10 * harm, -1.0, 1.0))
        key = state.info["key"]
        count = state.info["step"] + 1
        done = (fell | (count >= 60)).astype(jnp.float32)
        after = self._state(data, reward, done, {"key": key, "step": count})
        # The next episode begins with another scene of the bank.
        fresh = self.reset(key).replace(reward=reward, done=done, metrics=after.metrics)
        return jax.tree.map(lambda new, old: jnp.where(done > 0, new, old), fresh, after)

    def _places(self, data: mjx.Data) -> tuple[jax.Array, jax.Array]:
        return data.qpos[self.box : self.box + 2], data.qpos[self.can : self.can + 2]

    def _state(self, data: mjx.Data, reward: jax.Array, done: jax.Array, info: dict) -> State:
        box, can = self._places(data)
        obs = jnp.clip(
            jnp.nan_to_num(jnp.concatenate([5 * box, 5 * (can - box), data.qvel])), -5, 5
        )
        near = jnp.linalg.norm(box) < 0.05
        return State(data, obs, reward, done, {"near": near.astype(jnp.float32)}, info)


# %%
class Net(nn.Module):  # a Beta policy, and a value
    @nn.compact
    def __call__(self, obs: jax.Array) -> tuple[Beta, jax.Array]:
        act, value = (nn.tanh(nn.Dense(64)(nn.tanh(nn.Dense(64)(obs)))) for _ in range(2))
        raw = nn.Dense(4, kernel_init=nn.initializers.orthogonal(0.01))(act)
        return Beta.from_raw(raw.reshape(*raw.shape[:-1], 2, 2)), nn.Dense(1)(value)[..., 0]


# %%
config = PPOConfig(num_minibatches=4, discount=0.97, num_attempts=80_000)
learner = PPO(Push(bank), Net().apply, config)
state = learner.start(jax.random.key(0), Net().init(jax.random.key(1), jnp.zeros((1, 16))))
# MJX's arrays are; else the second update compiles anew
state = jax.device_put(state, jax.devices()[0])
update = jax.jit(learner.update)
started = time.monotonic()
for number in range(1, config.num_updates + 1):
    state, figures = update(state)
    print(f"{time.monotonic() - started:4.0f} s, {number * config.batch_size:6d} steps: "
          f"reward {figures['reward']:.4f}, in the middle {figures['env/near']:.0%}")  # fmt: skip
