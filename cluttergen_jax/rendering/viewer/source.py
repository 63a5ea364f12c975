"""Where a viewer's scenes come from, and where those made by hand go; the command line fills it in."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from cluttergen_jax.assets.support import Rectangle, SupportAsset
from cluttergen_jax.placement.hand import HandScene
from cluttergen_jax.placement.replay import Replay


class SceneSource(Protocol):
    """Scenes to look at, by number, and new ones."""

    @property
    def name(self) -> str:
        """What to call it; part of file names."""
        ...

    @property
    def numbers(self) -> Sequence[int]:
        """The scenes that it holds, at least one, in ascending order; where they are seeds, a vast range."""
        ...

    @property
    def methods(self) -> tuple[str, ...]:
        """How new scenes can be sampled; empty if they cannot."""
        ...

    def notice(self, method: str | None = None) -> str:
        """What to say while a scene by `method`, or by number, is made; empty where it comes at once."""
        ...

    def still(self, number: int) -> Replay:
        """A scene as it is stored, perhaps without its attempts. Quick."""
        ...

    def replay(self, number: int, num_proposals: int = 0, last_only: bool = False) -> Replay:
        """A scene with its attempts, and with so many other proposals at each of them.

        Args:
          last_only: only at the first attempt of the last object's last turn.

        Raises:
          ClutterGenError: they are not known; it says why.
        """
        ...

    def sample(
        self, method: str, seed: int, num_proposals: int = 0, last_only: bool = False
    ) -> Replay:
        """A new scene by one of `methods`; see `replay`."""
        ...


class HandScenes(Protocol):
    """Scenes that a person is to make, one after another, and where they are kept."""

    num_kept: int
    keep_out: tuple[Rectangle, ...]

    @property
    def name(self) -> str:
        """What to call the place where they are kept."""
        ...

    @property
    def support(self) -> SupportAsset:
        """What carries the objects."""
        ...

    @property
    def region(self) -> Rectangle:
        """The queried region."""
        ...

    def begin(self) -> HandScene:
        """The next scene, with none of its objects placed."""
        ...

    def keep(self, scene: HandScene) -> None:
        """Stores a scene, whatever became of it, and closes it.

        Raises:
          ClutterGenError: it cannot be stored now; it may be kept later.
        """
        ...
