"""What all trainings share: a folder that is continued by its recipe, steps in it, and Ctrl-C at any time."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import partial
from importlib.metadata import version
from pathlib import Path
from types import FrameType
from typing import Any, Protocol, TypeVar

import numpy as np

from cluttergen_jax.errors import ConfigError
from cluttergen_jax.kept_folder import KeptFolder, check_recipe, hold
from cluttergen_jax.learning.ppo.checkpoint import has_state, read_record, read_state, save_state
from cluttergen_jax.numerics import with_own_settings
from cluttergen_jax.progress import COMPILING, Progress, run_abandonable
from cluttergen_jax.schema import Record
from cluttergen_jax.types import Array

SAVE_EVERY = 60.0
"""Seconds between two states that are stored."""
_OF_A_RUN = (".csv", ".png", ".log", ".txt", ".out")
"""Endings of files in a run's folder before its state is stored first, what users keep there among them."""

T = TypeVar("T")


class Interrupt:
    """While it is entered, the first Ctrl-C (or SIGTERM) only sets `is_asked`; a second interrupts at once.

    Outside the main thread, where Python allows no handlers, it does nothing.
    """

    _SIGNALS = (signal.SIGINT, signal.SIGTERM)

    def __init__(self) -> None:
        self.is_asked = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> Interrupt:
        if threading.current_thread() is threading.main_thread():
            self._before = {number: signal.signal(number, self._ask) for number in self._SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def run_compiling(self, function: Callable[..., T], *args: Any) -> T:
        """The result of a call that compiles, and before which there is nothing to save.

        Raises:
          KeyboardInterrupt: on Ctrl-C or SIGTERM, which do not wait for it.
        """
        if threading.current_thread() is not threading.main_thread():
            return function(*args)
        return run_abandonable(lambda: self.is_asked, with_own_settings(function), *args)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        if self.is_asked:
            raise KeyboardInterrupt
        self.is_asked = True


def hold_run(folder: Path, patience: float = 0.0) -> AbstractContextManager[None]:
    """Holds a run's folder in the block, which is made if need be; a `RunFolder` is made there.

    Args:
      patience: seconds to wait for another process.

    Raises:
      ConfigError: the place holds no run. BankError: another process writes there, or it cannot be written.
    """
    return hold(_kept_folder(folder).lock(patience))


def _kept_folder(folder: Path) -> KeptFolder:
    return KeptFolder(
        folder,
        lambda _: has_state(folder / "last"),
        "{other} belongs to no run",
        _is_of_a_run,
        ConfigError,
    )


def _is_of_a_run(path: Path) -> bool:
    """Whether a run without a state may have left this, or a user beside it."""
    return not path.is_file() or path.name.startswith(".") or path.suffix in _OF_A_RUN


class Stepped(Protocol):
    """A state, a pytree; `step` i32 says how many steps are done."""

    @property
    def step(self) -> Array: ...


State = TypeVar("State", bound=Stepped)


class RunFolder:
    """The folder of a run, in which `last/` holds the state to go on from, with the recipe.

    Args:
      path: continued if it holds a run of the same recipe.
      recipe: what decides the run, JSON values.

    Raises:
      ConfigError: it holds a run of another recipe, and the message says what differs; or something else.
    """

    def __init__(self, path: Path, recipe: Mapping[str, Any]) -> None:
        self.path = path
        self.recipe = dict(recipe)
        self._last = path / "last"
        self.check()

    def check(self) -> None:
        """Refuses a folder of another recipe, or that holds no run, as the constructor does."""
        _kept_folder(self.path).check_place()
        if self.is_begun:
            theirs = read_record(self._last)
            known = {name: theirs.get(name) for name in self.recipe}
            check_recipe(self.path, "a run", self.recipe, known, error=ConfigError)

    @property
    def is_begun(self) -> bool:
        """Whether there is a state to go on from."""
        return has_state(self._last)

    def load(self, fresh: T) -> T:
        """The state to go on from; `fresh`, which has its structure, where there is none."""
        if not self.is_begun:
            return fresh
        stored: T = read_state(self._last, fresh)
        return stored

    def save(self, state: Any, **more: Any) -> None:
        """Stores the state to go on from, with the recipe and more (OSError: it cannot be written)."""
        save_state(self._last, state, {**self.recipe, **more})

    def record(self, name: str) -> Record:
        """The record of the state or the weights in a folder of this name; empty where there are none."""
        folder = self.path / name
        return read_record(folder) if (folder / "record.json").exists() else {}

    def learn(
        self,
        state: State,
        num_steps: int,
        step: Callable[[int, State], tuple[State, str]],
        interrupt: Interrupt | None = None,
    ) -> State:
        """Makes the steps that are left, fewer on Ctrl-C; the state, which is stored every minute and last.

        Args:
          step: given its number and the state: the next state, and what to say.
          interrupt: who asks for a stop, in place of Ctrl-C alone.
        """
        first = int(state.step)
        saved = time.monotonic()
        with interrupt or Interrupt() as interrupt:
            with Progress("learning", num_steps, "step", kept=first) as progress:
                progress.say(COMPILING)
                for number in range(first, num_steps):
                    if interrupt.is_asked:
                        break
                    call: Callable[..., tuple[State, str]] = step
                    if number == first:
                        # It compiles, and before it there is nothing to save.
                        call = partial(interrupt.run_compiling, step)
                    state, note = call(number, state)
                    progress.update(note=note)
                    if number == first:
                        progress.begin_timing()
                    if time.monotonic() - saved > SAVE_EVERY:
                        self.save(state)
                        saved = time.monotonic()
            self.save(state)
        return state


def batch_of(number: int, batch_size: int, num_examples: int, seed: int) -> np.ndarray:
    """i[B]: the examples of step `number`; each epoch, of whole batches, has an order of its own."""
    epoch, place = divmod(number, num_examples // batch_size)
    order = np.random.default_rng([seed, epoch]).permutation(num_examples)
    return order[place * batch_size : (place + 1) * batch_size]


def versions() -> dict[str, str]:
    """Of what trains, as records have them."""
    return {name: version(name) for name in ("cluttergen_jax", "mujoco", "jax", "flax")}
