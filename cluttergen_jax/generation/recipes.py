"""Objects that hold an engine are pickled, copied and printed as the call that made them."""

from __future__ import annotations

import inspect
from functools import partial
from typing import Any, TypeVar

T = TypeVar("T")


def required_recipe(recipe: partial[T] | None, maker: str) -> partial[T]:
    """The recipe, by which an object is made again when it is unpickled.

    Raises:
      TypeError: there is none: the object was not made by `maker`.
    """
    if recipe is None:
        raise TypeError(f"it holds an engine, and is pickled as the call of {maker} that made it; none did")
    return recipe


def recipe_text(recipe: partial[Any] | None) -> str:
    """The arguments of the call in one line, those with the default left out; "" if there is none."""
    if recipe is None:
        return ""
    parameters = inspect.signature(recipe.func).parameters
    given = dict(zip(parameters, recipe.args, strict=False)) | recipe.keywords
    usual = {name: each.default for name, each in parameters.items()}
    other = {name: value for name, value in given.items() if name not in usual or usual[name] != value}
    return ", ".join(f"{name}={value!r}" for name, value in other.items())
