"""A bank of scenes that a person makes: which scene comes next, and each kept as soon as it is done."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType

import jax
import numpy as np
import pyarrow as pa

from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.config import HAND
from cluttergen_jax.errors import BankError, ConfigError
from cluttergen_jax.files import writing
from cluttergen_jax.generation.files import write_files, write_model
from cluttergen_jax.generation.generate import GeneratedBank
from cluttergen_jax.generation.recipe import recipe_of
from cluttergen_jax.learning.methods import Method
from cluttergen_jax.numerics import new_key
from cluttergen_jax.placement.hand import HandError, HandScene
from cluttergen_jax.placement.problem import Setup, make_setup
from cluttergen_jax.placement.scenes import BLOCK_SIZE
from cluttergen_jax.placement.world import base_name
from cluttergen_jax.scene.bank import BankWriter, read_bank
from cluttergen_jax.scene.bank.blocks import StoredBlocks
from cluttergen_jax.scene.bank.card import write_card
from cluttergen_jax.scene.bank.remote import publish_all, url_of
from cluttergen_jax.scene.bank.stats import totals_of
from cluttergen_jax.scene.bank.table import BY_HAND, table_of
from cluttergen_jax.scene.bank.writer import names_of
from cluttergen_jax.spec import SceneSpec

_LOST = "a copy of that file: what was made by hand cannot be made again"


class HandBank:
    """A bank in which a person's scenes are kept one by one, failures included, with the seconds they took.

    A context manager: it holds the bank's lock until it is closed. Scene i is drawn with the key
    fold_in(key(seed), i), as by any method; a bank that is continued goes on with the next.

    Args:
      out: the bank's folder, or a URL.
      setup: the problem; keep_out: its boxes; seed: the bank's.
      overwrite: begin anew if the folder holds another bank.

    Attributes:
      num_kept: scenes that are in it.

    Raises:
      BankError: as `BankWriter`; or a block of the bank is damaged.
    """

    def __init__(
        self,
        out: str | Path,
        setup: Setup,
        keep_out: Sequence[Rectangle],
        seed: int,
        overwrite: bool = False,
    ) -> None:
        problem = setup.problem
        self.setup = setup
        self.keep_out = tuple(keep_out)
        self._seed = seed
        recipe = recipe_of(problem, Method(HAND), seed, keep_out)
        # A person tries as often as they like.
        del recipe["placement"]["max_attempts"]
        names = names_of(problem.world.objects)
        self._writer = BankWriter(out, recipe, 1, names, problem.world.support, overwrite)
        try:
            self.num_kept = _num_rows(self._writer.path)
            if self.num_kept:
                self._mend()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> HandBank:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Lets others write."""
        self._writer.close()

    @property
    def name(self) -> str:
        """The folder's."""
        return self._writer.path.resolve().name

    @property
    def support(self) -> SupportAsset:
        """What carries the objects."""
        return self.setup.problem.world.support

    @property
    def region(self) -> Rectangle:
        """The queried region."""
        return self.setup.problem.region

    def begin(self) -> HandScene:
        """The next scene, with none of its objects placed."""
        key = jax.random.fold_in(new_key(self._seed), self.num_kept)
        return HandScene(self.setup, key, self.num_kept)

    def rehearse(self) -> None:
        """Compiles what an attempt and a row need, so that nobody waits for it later."""
        scratch = self.begin()
        with suppress(HandError):
            scratch.lower()
        scratch.drop()
        self._row(scratch)

    def keep(self, scene: HandScene) -> None:
        """Stores a scene that `begin` gave, whatever became of it, and closes it; all is on disk then.

        Raises:
          BankError: it cannot be written; it may be kept later.
        """
        # What is stored is the time up to now, not what storing takes.
        scene.clock.stop()
        bank = read_bank(self._writer.path)
        index = self.num_kept
        # Asked for before it is there: a writer that is killed in between leaves an interrupted bank.
        self._writer.extend(index + 1)
        self._writer.write_block(index // BLOCK_SIZE, self._rows_with(scene, index))
        self.num_kept += 1
        scene.close()
        if (row := bank.rows([index])[index]).is_success:
            objects = [bank.object(base_name(name)) for name in row.objects]
            self._writer.keep_digests(write_model(bank, row, objects, self.setup.problem.config))
        with writing(bank.path):
            write_card(read_bank(bank.path))
            publish_all(bank.path)

    def summary(self) -> GeneratedBank:
        """The bank as it is now; printed, it tells how well it went."""
        bank = read_bank(self._writer.path)
        text = totals_of(bank.tables()).text() if self.num_kept else "scenes     none was kept"
        place = url_of(bank.path) or bank.path
        return GeneratedBank(bank.path, bank.record, summary=f"{text}\nbank       {place}")

    def _rows_with(self, scene: HandScene, index: int) -> pa.Table:
        """The rows of the scene's block, with the scene's own as the last one."""
        row = self._row(scene)
        if index % BLOCK_SIZE == 0:
            return row
        before = (
            StoredBlocks(self._writer.path).read_block(index // BLOCK_SIZE).select(row.schema.names)
        )
        return pa.concat_tables([before.cast(row.schema), row]).combine_chunks()

    def _row(self, scene: HandScene) -> pa.Table:
        problem = self.setup.problem
        index = np.array([self.num_kept])
        batch = jax.tree.map(lambda leaf: np.asarray(leaf)[None], scene.result())
        half_extents = np.asarray(problem.rules.geometry.half_extents)
        row = table_of(index, batch, problem.world.names, half_extents)
        return row.append_column(
            BY_HAND.field("seconds"), pa.array([scene.clock.seconds], pa.float32())
        )

    def _mend(self) -> None:
        """Writes what a killed writer left out beside the table."""
        bank = read_bank(self._writer.path)
        with writing(bank.path):
            write_files(
                bank, self.num_kept, self.setup.problem.config, False, self._writer.keep_digests
            )
            write_card(read_bank(bank.path))


def hand_setup(spec: SceneSpec) -> Setup:
    """The problem that a person solves (`make_setup`): attempts as they like, none looked back on."""
    spec.check_sense()
    pool = spec.find_pool()
    config = spec.problem_config(None, pool)
    config = replace(config, placement=replace(config.placement, history_stride=0, doors=None))
    setup = make_setup(config, spec.boxes(), pool=pool)
    support = setup.problem.world.support
    if support.named and not support.chosen.is_level:
        raise ConfigError(
            f"placing by hand on {support.name!r}, a slope", "a level surface", "bookcase"
        )
    if setup.problem.rules.surfaces is not None:
        given = f"placing by hand on {len(support.asked)} surfaces of {support.name!r}"
        raise ConfigError(given, "one surface", f"surface={support.asked[0][0].name!r}")
    return setup


def _num_rows(path: Path) -> int:
    """The scenes that a bank holds; BankError where its last block is damaged."""
    stored = StoredBlocks(path)
    if not stored.places:
        return 0
    last = max(stored.places)
    try:
        return last * BLOCK_SIZE + stored.num_rows(last)
    except BankError as error:
        raise BankError(error.given, error.allowed, _LOST) from error
