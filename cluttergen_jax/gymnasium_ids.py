"""Ids of environments for `gymnasium.make`; nothing is imported until Gymnasium is."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import sys
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

_ENTRY = "cluttergen_jax.downstream.environments.api:make_robot_env"


def register_ids(tasks: Mapping[str, str]) -> None:
    """Makes ids known now if Gymnasium is imported already, else as soon as it is.

    Gymnasium itself looks for no plugins, and importing it here would cost everybody who trains nothing.

    Args:
      tasks: of `robot.make_env`, by id.
    """
    if "gymnasium" in sys.modules:
        _register(tasks)
    elif not any(isinstance(finder, _Waiting) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Waiting(tasks))


def _register(tasks: Mapping[str, str]) -> None:
    from gymnasium.envs.registration import register, registry

    for name, task in tasks.items():
        if name not in registry:
            register(name, entry_point=_ENTRY, kwargs={"task": task})


class _Waiting(importlib.abc.MetaPathFinder):
    """Stands before the other finders until Gymnasium is imported, and then goes.

    Who only asks whether it is installed (`importlib.util.find_spec`) does not make it go.
    """

    def __init__(self, tasks: Mapping[str, str]) -> None:
        self._tasks = tasks

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Of Gymnasium what the others find, with a loader that registers; of all else nothing."""
        if name != "gymnasium":
            return None
        others = [each for each in sys.meta_path if not isinstance(each, _Waiting)]
        found = (each.find_spec(name, path, target) for each in others)
        spec = next((each for each in found if each is not None), None)
        if spec is not None and spec.loader is not None:
            spec.loader = _Registering(spec.loader, self._tasks)
        return spec


class _Registering(importlib.abc.Loader):
    """Loads a module as its own loader does, then registers."""

    def __init__(self, own: Any, tasks: Mapping[str, str]) -> None:
        self._own = own
        self._tasks = tasks

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType | None:
        """As its own loader."""
        found: ModuleType | None = self._own.create_module(spec)
        return found

    def exec_module(self, module: ModuleType) -> None:
        """As its own loader, which the module keeps; then the ids are known."""
        assert module.__spec__ is not None
        module.__spec__.loader = self._own
        module.__loader__ = self._own
        self._own.exec_module(module)
        sys.meta_path[:] = [each for each in sys.meta_path if not isinstance(each, _Waiting)]
        _register(self._tasks)
