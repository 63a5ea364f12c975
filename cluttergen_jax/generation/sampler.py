"""The scene sampler: a pure function from a key to a scene."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Unpack

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from cluttergen_jax.assets import SupportAsset, public_name
from cluttergen_jax.assets.support import Rectangle
from cluttergen_jax.config import check_range, check_whole
from cluttergen_jax.errors import ConfigError, range_text
from cluttergen_jax.generation.arguments import (
    check_call,
    check_key,
    is_known,
    recipe_text,
    region_fits,
    required_recipe,
    start_fits,
)
from cluttergen_jax.learning.methods import Method, choose_method, sampler_of, with_history_of
from cluttergen_jax.numerics import as_float32, with_own_settings
from cluttergen_jax.placement import Episode, KeepOut, Region, Start
from cluttergen_jax.placement.observation import ObservationConfig, observe
from cluttergen_jax.placement.problem import Problem, Setup, make_setup
from cluttergen_jax.placement.relations import SIDES, parse_relations
from cluttergen_jax.placement.rollout import BlockSampler, varying_alike
from cluttergen_jax.placement.scenes import BLOCK_SIZE, SceneBatch, scene_of
from cluttergen_jax.placement.shelves import Shelves
from cluttergen_jax.scene import Bank, Origin, Scene
from cluttergen_jax.scene.bank.scene import read_start
from cluttergen_jax.spec import SceneOptions, SceneSpec, spec_of, takes_spec
from cluttergen_jax.types import Array, Verdict


class _Drawing(struct.PyTreeNode):
    """A scene in the making, and how often it has been begun."""

    episode: Episode
    num_draws: Array


class _Recipe(partial[Any]):
    """The call that made a sampler, and the parts of which it made it; a plain call where it is pickled."""

    parts: tuple[Any, ...] = ()

    def __reduce__(self) -> Any:
        return partial(self.func, *self.args, **self.keywords).__reduce__()


@dataclass(frozen=True, eq=False, repr=False)
class Sampler:
    """Samples one scene from a key; see `make_sampler`. Map it with `jax.vmap`, compile it with `jax.jit`.

    It is a pytree: with a shelf of a pool it can be an argument of what is compiled, which then serves every
    shelf:

        many = jax.jit(lambda sample, keys: jax.vmap(sample)(keys))
        sample = sample.reshelve(key)
        scenes = many(sample, keys)

    It is pickled as the arguments of `make_sampler`, which is called with them where it is read: pools,
    supports, checkpoints and banks that they name have to be there. A copy is the sampler itself. One that
    `dataclasses.replace` made with another part was made by no such call: it has no recipe, is not pickled,
    and draws no other shelf. `make_sampler` with other arguments makes one that can be.

    Attributes:
      problem: the compiled world, its rules and its queried region.
      steps: who proposes, and how an attempt is made.
      keep_out: where no object may come to lie, unless another is given in the call.
      start: what stands there already, unless another is given in the call.
      max_retries: how often a scene that fails is drawn again.
      num_scene_points: points of the scene's cloud; 0 for none.
      recipe: the call that made it, of these very parts; None if it was made by hand. Nobody gives it.
      shelves: what `reshelve` draws from, and by which method scenes are made; None where all objects of the
        pool are in one world.
    """

    problem: Problem
    steps: BlockSampler
    keep_out: KeepOut
    start: Start
    max_retries: int
    num_scene_points: int
    recipe: partial[Sampler] | None = None
    shelves: tuple[Shelves, Method] | None = None

    def __post_init__(self) -> None:
        if self.recipe is None:
            return
        if not isinstance(self.recipe, _Recipe):
            given = f"recipe = {self.recipe!r} of a sampler that it did not make"
            raise ConfigError(given, "None", "that call, which makes a sampler with its recipe")
        if any(
            mine is not made for mine, made in zip(self._parts(), self.recipe.parts, strict=True)
        ):
            object.__setattr__(self, "recipe", None)

    def _parts(self) -> tuple[Any, ...]:
        return tuple(getattr(self, each.name) for each in fields(self) if each.name != "recipe")

    def _made_by(self, make: Callable[..., Sampler], *args: Any, **keywords: Any) -> Sampler:
        """The sampler with the call that made it."""
        recipe = _Recipe(make, *args, **keywords)
        recipe.parts = self._parts()
        return replace(self, recipe=recipe)

    def write_bank(self, path: str | Path, scenes: Sequence[Scene], method: str, seed: int) -> Bank:
        """Writes scenes of its objects on its support, which stand, as a bank; one with fewer is continued.

        Args:
          method, seed: what its recipe says of how they were made.

        Raises:
          BankError: the folder holds something else.
        """
        from cluttergen_jax.generation.given import write_scenes

        return write_scenes(path, self.problem, scenes, method, seed)

    def reshelve(self, key: Array) -> Sampler:
        """The same sampler with other objects of its pool, drawn with a key. Nothing is compiled anew.

        It takes about a second: their meshes are read, and MuJoCo makes a model of them.

        Raises:
          ConfigError: the sampler has no shelf, `key` is not one key, or it is traced.
        """
        check_key(key, "reshelve")
        if not is_known(key):
            hint = "the new sampler as an argument of that code"
            raise ConfigError("reshelve(key) in compiled code", "a key that is known", hint)
        return self._with_shelf(lambda shelves: shelves.setup(shelves.draw(key)))

    def for_block(self, seed: int, block: int) -> Sampler:
        """The same sampler with the objects of a bank's block: of scenes 256 `block` to 256 `block` + 255.

        Raises:
          ConfigError: the sampler has no shelf, or a number is out of range.
        """
        check_range("seed", seed, 0, 2**32 - 1, 0)
        check_range("block", block, 0, (2**32 - 1) // BLOCK_SIZE, 0)
        return self._with_shelf(lambda shelves: shelves.block(seed, block))

    def _with_shelf(self, draw: Callable[[Shelves], Setup]) -> Sampler:
        if self.shelves is None:
            raise ConfigError(
                "another shelf of a sampler that has all its objects in one world",
                "a sampler with a shelf",
                "make_sampler(shelf=64)",
            )
        if self.recipe is None:
            raise ConfigError(
                "another shelf of a sampler of which a part was replaced",
                "a sampler as `make_sampler` made it",
                "make_sampler(shelf=64, ...) with other arguments in place of other parts",
            )
        shelves, method = self.shelves
        setup = draw(shelves)
        drawn = replace(
            self, problem=setup.problem, steps=sampler_of(setup, method), start=setup.start
        )
        return drawn._made_by(_put_on_shelf, self.recipe, setup.problem.world.names)

    def __reduce__(self) -> tuple[Any, ...]:
        return required_recipe(self.recipe, "make_sampler"), ()

    def __copy__(self) -> Sampler:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Sampler:
        return self

    def __repr__(self) -> str:
        return f"Sampler({recipe_text(self.recipe) or f'{len(self.names)} objects'})"

    @with_own_settings
    def __call__(
        self,
        key: Array,
        region: Region | None = None,
        keep_out: KeepOut | None = None,
        start: Start | None = None,
    ) -> SceneBatch:
        """One scene. All arguments may be traced, and mapped over.

        Args:
          key: one PRNG key, consumed. `jax.random.fold_in(jax.random.key(seed), i)` makes scene i of the bank
            that `cluttergen generate --seed` writes with the same settings.
          region: a queried region on the same support, no larger than the sampler's own
            (`placement.region.make_region`), its sides compared one by one, along its own axes.
          keep_out: where no object may come to lie.
          start: what stands there already: objects of this sampler's world, no more than it was made for.

        A region or a start that does not fit is refused where it is known. Where it is traced, the scene is
        no success, its verdict is OUTSIDE, and it is not drawn again.

        Raises:
          ConfigError: `key` is not one key, another argument is of a wrong type or shape, the region is
            empty, not finite, too large or not on the support, or too many objects stand there already.
        """
        check_key(key)
        check_call(region, keep_out, start)
        region, keep_out, start = as_float32((region, keep_out, start))
        rules = self.steps.rules
        support = self._support
        if region is not None and rules.surfaces is not None:
            raise ConfigError(
                "a region in a call, with several surfaces", "their own regions", "one `surface`"
            )
        if region is not None and rules.polygon is not None:
            raise ConfigError(
                "a region in a call, with a polygon for a region", "the polygon", "a rectangle"
            )
        fits = jnp.bool_(True) if region is None else region_fits(region, rules.region, support)
        if start is not None:
            fits &= start_fits(start, rules.num_started)
        begin = partial(
            rules.begin,
            region=region,
            keep_out=self.keep_out if keep_out is None else keep_out,
            start=self.start if start is None else start,
        )

        def advance(drawing: _Drawing) -> _Drawing:
            episode = self.steps.step_one(drawing.episode)[0]
            num_draws = drawing.num_draws
            if not self.max_retries:
                return drawing.replace(episode=episode)
            again = fits & episode.is_over & ~episode.is_success & (num_draws <= self.max_retries)
            # The key of an episode that is over has not been used.
            fresh = begin(episode.key)
            episode = jax.tree.map(lambda new, old: jnp.where(again, new, old), fresh, episode)
            return varying_alike(_Drawing(episode, num_draws + again))

        first = varying_alike(_Drawing(begin(key), jnp.int32(1)))
        last = jax.lax.while_loop(lambda drawing: ~drawing.episode.is_over, advance, first)
        scene = scene_of(last.episode)
        (cloud, mask) = self._cloud(last.episode)
        return scene.replace(
            is_success=scene.is_success & fits,
            verdict=jnp.where(fits, scene.verdict, int(Verdict.OUTSIDE)),
            region=last.episode.region,
            num_draws=last.num_draws,
            cloud=cloud,
            cloud_mask=mask,
            shelf=rules.engine,
        )

    def _cloud(self, episode: Episode) -> tuple[Array, Array] | tuple[None, None]:
        """f32[N, 3], world frame, and bool[N]; None for no points."""
        if not self.num_scene_points:
            return None, None
        seen = observe(
            self.steps.rules, episode, ObservationConfig(num_scene_points=self.num_scene_points)
        )
        cloud = jax.vmap(episode.region.T_world_region.apply)(jnp.asarray(seen["scene_cloud"]))
        return cloud, jnp.asarray(seen["scene_mask"])

    @property
    def _support(self) -> SupportAsset:
        problem: Any = self.problem
        return problem.support if isinstance(problem, _InCompiledCode) else problem.world.support

    @property
    def names(self) -> tuple[str, ...]:
        """The compiled world's objects, in the order of `SceneBatch.object_index`."""
        return self.problem.world.names

    @with_own_settings
    def scene(self, sampled: SceneBatch | Array, index: int = 0) -> Scene:
        """One scene on the host, as pictures, exports and models (`Scene.to_mjspec`) take it.

            sample.scene(jax.random.key(0)).picture()

        Args:
          sampled: a scene without leading axes, or a batch with one, of which number `index` is taken. Or one
            PRNG key, of which a scene is sampled; the first call compiles that for some seconds.

        Raises:
          ConfigError: the batch has no such scene, or more than one leading axis; it is of another shelf; or
            what is given is neither scenes nor one key, or traced.
        """
        if not isinstance(sampled, SceneBatch):
            check_key(sampled, "scene")
            if not is_known(sampled):
                hint = "scene(sample(key)) outside of it, of what the compiled code returns"
                raise ConfigError("scene(key) in compiled code", "a key that is known", hint)
            if index:
                raise ConfigError(f"scene {index} of one key", "0", "another key")
            # What another shelf has compiled serves this one, too.
            has_shelf = self.shelves is not None
            sampled = _sample_shelved(self, sampled) if has_shelf else self._program(sampled)
        shape = np.shape(sampled.is_success)
        if len(shape) > 1 or not 0 <= index < (shape[0] if shape else 1):
            nothing = "scenes, of which these are none"
            allowed = (
                range_text(0, (*shape, 1)[0] - 1, nothing) if len(shape) < 2 else "one leading axis"
            )
            raise ConfigError(f"scene {index} of scenes of shape {shape}", allowed)
        if shape:
            sampled = jax.tree.map(lambda leaf: leaf[index], sampled)
        world = self.problem.world
        config = self.problem.config
        own = self.steps.rules.engine
        if own is not None and sampled.shelf is not None and int(sampled.shelf) != int(own):
            raise ConfigError(
                "scenes of another shelf than this sampler's",
                "scenes that it made itself",
                "the sampler that `reshelve` gave, kept in a variable",
            )
        placed = np.asarray(sampled.is_placed)
        chosen = [int(each) for each in np.asarray(sampled.object_index)[placed]]
        support = world.finished_support
        if world.doors is not None and sampled.doors is not None and not bool(sampled.is_success):
            support = world.doors.at(np.asarray(sampled.doors.travel))
        return Scene(
            names=tuple(world.names[each] for each in chosen),
            objects=tuple(world.objects[each] for each in chosen),
            poses=np.asarray(sampled.poses)[placed],
            support=support,
            stability=config.stability,
            contact=config.contact,
            origin=Origin(
                index=index,
                pool=public_name(config.pool),
                verdict=Verdict(int(sampled.verdict)).label,
                is_success=bool(sampled.is_success),
                drift=float(sampled.drift),
            ),
            region=self._rectangle(sampled.region),
            seat=config.placement.seat if config.placement.natural else "",
            has_sides=any(
                each.kind in SIDES for each in parse_relations(config.placement.relations)
            ),
        )

    @cached_property
    def _program(self) -> Callable[[Array], SceneBatch]:
        return jax.jit(partial(type(self).__call__, self))

    def _rectangle(self, region: Region | None) -> Rectangle:
        """The region of one scene, in the frame in which the sampler's own is given."""
        own = self.problem.region
        rules = self.steps.rules
        if region is None or rules.surfaces is not None:
            return own
        usual = rules.region
        if jax.tree.all(jax.tree.map(lambda a, b: bool(jnp.array_equal(a, b)), usual, region)):
            return own
        moved = usual.T_world_region.inverse() @ region.T_world_region
        (x, y, _) = np.asarray(moved.translation(), float)
        yaw = float(moved.rotation().as_rpy_radians().yaw)
        (half_x, half_y) = np.asarray(region.half_extents, float)
        if not (np.isfinite([x, y, yaw, half_x, half_y]).all() and min(half_x, half_y) > 0):
            # A traced region may be anything; then nothing was placed in it.
            return own
        cos = np.cos(own.yaw)
        sin = np.sin(own.yaw)
        return Rectangle(
            (float(own.center[0] + cos * x - sin * y), float(own.center[1] + sin * x + cos * y)),
            (float(half_x), float(half_y)),
            own.yaw + yaw,
        )


def _put_on_shelf(make: partial[Sampler], names: tuple[str, ...]) -> Sampler:
    """A sampler made by a call, with the objects of these names."""
    return make()._with_shelf(lambda shelves: shelves.setup(names))


class _InCompiledCode:
    """The problem of a sampler that is an argument of what is compiled: only its support is known there."""

    def __init__(self, support: SupportAsset) -> None:
        self.support = support

    def __getattr__(self, name: str) -> Any:
        raise ConfigError(
            f"{name!r} of a sampler in compiled code", "calls of it", "the sampler outside"
        )


def _flatten_sampler(sampler: Sampler) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
    static = sampler._support, sampler.max_retries, sampler.num_scene_points
    return (sampler.steps, sampler.keep_out, sampler.start), static


def _unflatten_sampler(static: tuple[Any, ...], parts: tuple[Any, ...]) -> Sampler:
    support, max_retries, num_scene_points = static
    problem: Any = _InCompiledCode(support)
    steps, keep_out, start = parts
    return Sampler(problem, steps, keep_out, start, max_retries, num_scene_points)


jax.tree_util.register_pytree_node(Sampler, _flatten_sampler, _unflatten_sampler)


@jax.jit
def _sample_shelved(sampler: Sampler, key: Array) -> SceneBatch:
    return sampler(key)


MAX_RETRIES = 10_000


@with_own_settings
@takes_spec({"sets": "by which a scene's number in a bank says its objects, and a key has none"})
def make_sampler(
    spec: SceneSpec | str | Path | None = None,
    *,
    max_retries: int = 0,
    num_scene_points: int = 0,
    **options: Unpack[SceneOptions],
) -> Sampler:
    """A function `sample(key) -> SceneBatch` that may be compiled, mapped, scanned and sharded.

    Nothing random is decided here: equal keys give equal scenes, within the limits that docs/contract.md
    names. The arguments that are not explained here are those of `SceneSpec`.

    Args:
      spec: what is asked for, or a pool's name.
      max_retries: a scene that fails is drawn again up to so often, inside the compiled code, until one
        passes; 0 to 10,000.
      num_scene_points: points of each scene's cloud, up to 200,000; 0 for none.
      options: fields of `SceneSpec`, in place of those of `spec`.

    Raises:
      ConfigError: a setting is unknown, out of range, or contradicts another.
      PoolError: a pool, an object, a support or a checkpoint cannot be found or read.
      BankError: the scene to start from cannot be read, or does not stand.
    """
    asked = spec_of(make_sampler, spec, options)
    check_range("max_retries", max_retries, 0, MAX_RETRIES, 5)
    check_whole(num_scene_points=num_scene_points)
    ObservationConfig(num_scene_points=num_scene_points)
    method, setup, shelves = set_up_bank(asked, 0)
    if asked.engine == "jax":
        warnings.warn(setup.problem.rules.simulator.compiling, stacklevel=2)
    return Sampler(
        problem=setup.problem,
        steps=sampler_of(setup, method),
        keep_out=setup.keep_out,
        start=setup.start,
        max_retries=max_retries,
        num_scene_points=num_scene_points,
        shelves=None if shelves is None else (shelves, method),
    )._made_by(
        make_sampler,
        **asked.overrides(),
        max_retries=max_retries,
        num_scene_points=num_scene_points,
    )


def set_up_bank(spec: SceneSpec, seed: int) -> tuple[Method, Setup, Shelves | None]:
    """A method, and the problem compiled for it, with its rules and history; errors: `make_sampler`.

    Last, what blocks draw their objects from, if they do: then the setup is that of block 0.
    """
    method = choose_method(spec.method, spec.pool_text, spec.checkpoint)
    spec.check_method(method.name)
    spec.check_sense()
    pool = spec.find_pool()
    config = spec.problem_config(method.name, pool)
    config = replace(config, placement=with_history_of(config.placement, method.checkpoint))
    if not config.shelf:
        setup = make_setup(config, spec.boxes(), read_start(spec.start), pool=pool)
        return method, setup, None
    shelves = Shelves.of(config, spec.boxes(), pool)
    return method, shelves.block(seed, 0), shelves
