"""Parts of a user's own (method, placer, planner, observer): what they are called, and how told apart."""

from __future__ import annotations

import dis
import functools
import hashlib
import importlib
import importlib.util
import inspect
import io
import pickle
import sys
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numpy as np

from cluttergen_jax.errors import ConfigError

_PLACE = "FILE.py:NAME or MODULE:NAME"
_FROM_FILE = "cluttergen_own_file"
"""Before the name of a module that was run from a user's file."""
_FAULTS = (OSError, TypeError, AttributeError, ValueError, RecursionError, pickle.PicklingError)


def is_own(part: Any) -> bool:
    """Whether a part is a user's, not one of this package."""
    return not _home_of(part).startswith("cluttergen_jax.")


def load_module(text: str, what: str) -> tuple[ModuleType, str, str]:
    """What stands before the colon of "FILE.py:NAME" or "MODULE:NAME", imported.

    A module that is not installed may be a file below the working directory. A file is run once for as long
    as its content stays the same.

    Args:
      text: of a user. what: the argument that it was given as.

    Returns:
      the module, NAME, and the text, with the file's absolute path.

    Raises:
      ConfigError: the text is of another form, or importing fails.
    """
    where, _, name = text.rpartition(":")
    file = Path(where if where.endswith(".py") else f"{where.replace('.', '/')}.py")
    if not where or not name:
        raise ConfigError(f"{what} {text!r}", _PLACE, "my_file.py:mine")
    try:
        if where.endswith(".py") or (_is_missing(where) and file.is_file()):
            file = file.resolve()
            return _run_file(file), name, f"{file}:{name}"
        return importlib.import_module(where), name, text
    except Exception as error:  # A user's file raises whatever it does.
        raise ConfigError(
            f"{what} {text!r}, of which {where!r} cannot be imported: {error} ({type(error).__name__})",
            _PLACE,
            "the path of a file that `python` runs without an error",
        ) from error


def _is_missing(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is None
    except (ImportError, ValueError):
        return True


def _run_file(file: Path) -> ModuleType:
    if not file.is_file():
        raise FileNotFoundError(f"there is no file {file}")
    digest = _digest_of(str(file).encode(), file.read_bytes())
    name = f"{_FROM_FILE}.{digest}.{file.stem}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # Dataclasses of the file look for their module there.
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def module_name(part: Any) -> str:
    """The module of a function or class, one from a file without what tells files apart."""
    name = str(part.__module__)
    return name.split(".", 2)[2] if name.startswith(f"{_FROM_FILE}.") else name


def _home_of(part: Any) -> str:
    kind = part if inspect.isroutine(part) or isinstance(part, type) else type(part)
    return f"{kind.__module__}."


def part_name(part: Any) -> str:
    """What rows call a part: its attribute `name`, else that of its function or class."""
    inner = part.func if isinstance(part, functools.partial) else part
    name = getattr(part, "name", None) or getattr(inner, "__name__", None)
    return str(name or type(inner).__name__)


def part_label(part: Any, what: str) -> str:
    """Name and digest (`part_digest`) of a user's part, as recipes have them; of this package's its name.

    Args:
      what: the argument that it was given as.

    Raises:
      ConfigError: it cannot be called, or nothing tells it from others.
    """
    if not callable(part):
        raise ConfigError(f"{what} = {part!r}", "a name, or an object that can be called")
    if not is_own(part):
        return part_name(part)
    return f"{part_name(part)} {part_digest(part, what)}"


def part_digest(part: Any, what: str) -> str:
    """16 hex digits that tell a part from others: a part says its digest, else its source is hashed.

    It says it by an attribute `digest`, a text. Its source is that of its function or class and bases, with
    its attributes and those of its class, and the variables and functions of its module that the code
    names; random generators and what cannot be pickled are left out. What the code calls in other modules is
    not looked at. Of what has no source the attribute `name` is hashed.

    Args:
      what: the argument that it was given as.

    Raises:
      ConfigError: nothing tells it from others.
    """
    told = getattr(part, "digest", None)
    if isinstance(told, str) and told:
        return _digest_of(told.encode())
    try:
        inner = inspect.unwrap(part)
        return _digest_of(_code_of(inner), _bytes_of(_state_of(inner)), *_named_by(inner))
    except _FAULTS as error:
        name = getattr(part, "name", None)
        if not isinstance(name, str) or not name:
            raise ConfigError(
                f"{what} {part_name(part)!r}, which nothing tells from others: {error}",
                "a part whose source and attributes can be read, or with an attribute `digest` or `name`",
                "`digest`, a text that is another whenever the part does something else",
            ) from error
        return _digest_of(name.encode())


def _digest_of(*content: bytes) -> str:
    return hashlib.sha256(b"".join(content)).hexdigest()[:16]


def _code_of(part: Any) -> bytes:
    """The source of a function, or of the classes of an object."""
    if isinstance(part, functools.partial):
        return _code_of(part.func)
    if inspect.isroutine(part):
        return inspect.getsource(part).encode() + _code_of_lambda(part)
    classes = part.__mro__ if isinstance(part, type) else type(part).__mro__
    kinds = [kind for kind in classes[:-1] if kind.__module__ not in ("typing", "abc")]
    return inspect.getsource(kinds[0]).encode() + b"".join(_code_if_any(kind) for kind in kinds[1:])


def _code_if_any(part: Any) -> bytes:
    try:
        return inspect.getsource(part).encode()
    except (OSError, TypeError):
        return str(part.__qualname__).encode()


def _code_of_lambda(part: Any) -> bytes:
    """The compiled code of a lambda, since several may stand on one line of source; nothing for others."""
    if getattr(part, "__name__", "") != "<lambda>":
        return b""
    code: CodeType = part.__code__
    constants = [each for each in code.co_consts if not isinstance(each, CodeType)]
    return code.co_code + repr((constants, code.co_names, code.co_varnames)).encode()


def _named_by(part: Any) -> Iterator[bytes]:
    """Bytes of its class's attributes, and of the variables and functions of its module that it refers to."""
    while isinstance(part, functools.partial):
        part = part.func
    part = part.__self__ if inspect.ismethod(part) else part
    if inspect.isfunction(part):
        functions = [part]
    else:
        kind = part if isinstance(part, type) else type(part)
        own = [each for each in kind.__mro__ if each.__module__ == kind.__module__]
        held = [pair for each in own for pair in sorted(vars(each).items())]
        functions = [value for _, value in held if inspect.isfunction(value)]
        for name, value in held:
            if not (name.startswith("__") or hasattr(value, "__get__")):
                yield from (name.encode(), _bytes_if_any(value))
    seen: set[Any] = set(functions)
    while functions:
        function = functions.pop()
        for name in sorted(_names_in(function.__code__) & function.__globals__.keys()):
            value = inspect.unwrap(function.__globals__[name])
            if isinstance(value, ModuleType) or value is part:
                continue
            if not (inspect.isroutine(value) or isinstance(value, type)):
                yield from (name.encode(), _bytes_if_any(value))
            elif value.__module__ == function.__module__ and value not in seen:
                seen.add(value)
                yield _code_if_any(value)
                inner = vars(value).values() if isinstance(value, type) else [value]
                functions += filter(inspect.isfunction, inner)


def _names_in(code: CodeType) -> set[str]:
    """The global variables that code and functions inside of it read; `co_names` has attributes, too."""
    read = {
        each.argval
        for each in dis.get_instructions(code)
        if each.opname in ("LOAD_GLOBAL", "LOAD_NAME")
    }
    return read.union(*(_names_in(each) for each in code.co_consts if isinstance(each, CodeType)))


def _bytes_if_any(value: Any) -> bytes:
    try:
        return _bytes_of(value)
    except _FAULTS:
        return type(value).__qualname__.encode()


def _state_of(part: Any) -> Any:
    if isinstance(part, functools.partial):
        return part.args, part.keywords, _state_of(part.func)
    if inspect.ismethod(part):
        return _state_of(part.__self__)
    if inspect.isfunction(part):
        cells = [cell.cell_contents for cell in part.__closure__ or ()]
        return part.__defaults__, part.__kwdefaults__, cells
    return part.__getstate__()


class _Pickler(pickle.Pickler):
    """Equal bytes for equal states: of tensors their numbers, sets in order, of random generators nothing."""

    def persistent_id(self, found: Any) -> Any:
        if isinstance(found, np.random.Generator | np.random.RandomState):
            return "random"
        if isinstance(found, set | frozenset):
            return "set", sorted(map(_bytes_of, found))
        if hasattr(found, "detach") and hasattr(found, "numpy"):
            array = array_of(found)
            return str(array.dtype), array.shape, hashlib.sha256(array.tobytes()).hexdigest()
        return None


def _bytes_of(state: Any) -> bytes:
    buffer = io.BytesIO()
    pickler = _Pickler(buffer)
    # Without a memory of what came before, it does not matter which equal parts are one.
    pickler.fast = True
    pickler.dump(state)
    return buffer.getvalue()


def array_of(value: Any) -> np.ndarray:
    """NumPy's array of an array, a list, or a tensor of PyTorch on any device."""
    value = value.detach().cpu() if hasattr(value, "detach") else value
    return np.asarray(value)
