"""Checkpoints: a run's whole state (Orbax), and a policy's weights alone (NumPy, no pickle)."""

from __future__ import annotations

import errno
import io
import os
import re
import shutil
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import flax.traverse_util
import jax
import jax.numpy as jnp
import numpy as np

from cluttergen_jax.errors import PoolError
from cluttergen_jax.files import folder_whole, put_back, write_atomically
from cluttergen_jax.learning.ppo.sharding import with_keys, without_keys
from cluttergen_jax.schema import Record, SchemaError, checked_record, digest_of, record_bytes
from cluttergen_jax.types import Array

FORMAT = 1
_CRITIC = ("params/critic/", "params/value/")
"""What acting does not need; an attention layer has a `value` too, which it does."""
# Of a number, and of what stands before the numbers in a file of NumPy's.
_MOST_BYTES = 8
_HEADER = 4096

_BESIDE = 1 << 20
"""Bytes for what Orbax stores beside a state's numbers."""
_SHOWN = 3
_WEIGHTS = "weights_sha256"
"""In the record of a policy: the checksum of its weights."""
_FRESH = "a fresh copy of that folder, or training again"


def _checkpointer() -> Any:
    """Orbax's, which waits for no other process: where there are several, one alone reads and writes."""
    # Loaded by training alone: whoever acts reads NumPy's files.
    import orbax.checkpoint as ocp

    here = jax.process_index()
    alone = ocp.options.MultiprocessingOptions(primary_host=here, active_processes={here})
    return ocp.StandardCheckpointer(multiprocessing_options=alone)


def _numbered_leaves(tree: Any) -> dict[str, Array]:
    """The leaves that can be stored, by number: PRNG keys as plain arrays, empty arrays left out."""
    leaves = jax.tree.leaves(without_keys(tree))
    if jax.process_count() > 1:
        # Among several processes Orbax takes a JAX array for something that all of them hold together.
        leaves = [np.asarray(leaf) for leaf in leaves]
    return {f"{number:05d}": leaf for number, leaf in enumerate(leaves) if leaf.size}


def _from_numbered_leaves(stored: dict[str, Array], like: Any) -> Any:
    """The inverse of `_numbered_leaves`, guided by a tree of the same structure."""
    leaves, structure = jax.tree.flatten(without_keys(like))
    for number, leaf in enumerate(leaves):
        if leaf.size:
            leaves[number] = stored[f"{number:05d}"]
    return with_keys(jax.tree.unflatten(structure, leaves), like)


def save_state(path: Path, state: Any, record: Record) -> None:
    """Stores a pytree of arrays and a JSON record as one folder, whole or not at all.

    Raises:
      OSError: the disk is full, or the folder cannot be written for another reason.
    """
    leaves = _numbered_leaves(state)
    with folder_whole(path.absolute(), is_only_writer=True) as fresh:
        _check_room(path, sum(leaf.nbytes for leaf in leaves.values()))
        with _as_os_error(path), _checkpointer() as checkpointer:
            checkpointer.save(fresh / "state", leaves)
        (fresh / "record.json").write_bytes(_record_bytes(record))


def _check_room(path: Path, num_bytes: int) -> None:
    """Refuses a disk too full for a state: Orbax's threads print stack traces where they find no room."""
    if shutil.disk_usage(path.absolute().parent).free < num_bytes + _BESIDE:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


@contextmanager
def _as_os_error(path: Path) -> Iterator[None]:
    """Inside, what the operating system refused is an OSError, whatever Orbax made of it."""
    try:
        yield
    except Exception as error:
        # TensorStore says the number of the error in its text alone, and Orbax may fail again on its way out.
        each: BaseException | None = error
        while each is not None:
            if isinstance(each, OSError):
                raise OSError(each.errno, each.strerror or str(each), str(path)) from error
            if number := re.search(r"os_error_code='(\d+)'", str(each)):
                raise OSError(int(number[1]), os.strerror(int(number[1])), str(path)) from error
            each = each.__cause__ or each.__context__
        raise


def has_state(path: Path) -> bool:
    """Whether a state is stored there; one whose replacement was interrupted is put back first."""
    put_back(path)
    return path.exists()


def read_record(path: Path) -> Record:
    """The record stored beside a state or a policy.

    Raises:
      PoolError: there is no checkpoint, or it is damaged or of another format.
    """
    try:
        record = checked_record((path / "record.json").read_bytes(), allow_nan=True)
    except (OSError, SchemaError) as error:
        reason = f"record.json: {getattr(error, 'strerror', None) or error}"
        raise PoolError(
            f"{path} is not a checkpoint ({reason})", hint="cluttergen train makes one"
        ) from error
    if record.get("format") != FORMAT:
        raise PoolError(f"{path} is not a checkpoint of format {FORMAT}")
    return record


def read_state(path: Path, like: Any) -> Any:
    """The pytree that `save_state` stored; `like` has its structure, shapes and types."""
    with _checkpointer() as checkpointer:
        try:
            stored = checkpointer.restore((path / "state").absolute(), _numbered_leaves(like))
        except (ValueError, OSError, KeyError) as error:
            raise PoolError(f"{path} does not hold what this run needs ({error})") from error
    return _from_numbered_leaves(stored, like)


def save_policy(path: Path, params: Any, record: Record) -> None:
    """Stores the weights that acting needs, at half precision, and a JSON record.

    Of arrays that are equal, as in two frozen encoders that began alike, the first is stored; in place of
    each other one stands its name. High and low bytes are stored apart, u8[2, ...], which compresses better.
    """
    path.mkdir(parents=True, exist_ok=True)
    flat = flax.traverse_util.flatten_dict(params, sep="/")
    weights: dict[str, np.ndarray] = {}
    names: dict[tuple[tuple[int, ...], bytes], str] = {}
    for name, value in flat.items():
        if not name.startswith(_CRITIC):
            array = np.asarray(value, np.float16)
            stored = names.setdefault((array.shape, array.tobytes()), name)
            weights[name] = _in_bytes(array) if stored == name else np.array(stored)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **weights)  # type: ignore[arg-type]
    write_atomically(path / "weights.npz", buffer.getvalue())
    write_atomically(
        path / "record.json", _record_bytes({**record, _WEIGHTS: digest_of(buffer.getvalue())})
    )


def _record_bytes(record: Record) -> bytes:
    return record_bytes({"format": FORMAT, **record}, allow_nan=True)


def _in_bytes(array: np.ndarray) -> np.ndarray:
    """u8[2, ...], the low and the high byte of each number f16[...]."""
    bits = array.view(np.uint16)
    return np.stack([bits & 0xFF, bits >> 8]).astype(np.uint8)


def _from_bytes(array: np.ndarray) -> np.ndarray:
    """The inverse of `_in_bytes`; arrays of numbers, as earlier versions stored them, stay as they are."""
    if array.dtype != np.uint8 or array.ndim == 0 or len(array) != 2:
        return array
    low, high = array.astype(np.uint16)
    return (low | high << 8).view(np.float16)


def blank(init: Callable[..., Any], *arguments: Any) -> Any:
    """Zeros in place of the weights that `init` would make of these arguments."""
    shapes = jax.eval_shape(init, *arguments)
    return jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), shapes)


def read_policy(path: Path, like: Any) -> Any:
    """Parameters of the form of `like`, the actor's from a stored policy, the critic's left as they are.

    Raises:
      PoolError: the file is missing or damaged, or its arrays are not those of the network: one is missing
        or unknown, or of another shape or type, or holds a number that is not finite.
    """
    flat = flax.traverse_util.flatten_dict(like, sep="/")
    weights = _stored_weights(path / "weights.npz", flat)
    check_weights(path)
    merged = {
        name: jnp.asarray(weights.get(name, value), jnp.float32) for name, value in flat.items()
    }
    return flax.traverse_util.unflatten_dict(merged, sep="/")


def check_weights(path: Path) -> None:
    """Refuses weights that cannot be unpacked, or are not those that the record beside them says.

    Raises:
      PoolError: they are damaged, or others.
    """
    stated = read_record(path).get(_WEIGHTS) if (path / "record.json").exists() else None
    file = path / "weights.npz"
    if stated is not None:
        is_sound = digest_of(file.read_bytes()) == stated
    else:
        # Earlier records do not say it; an archive knows at least its own checksums.
        try:
            with zipfile.ZipFile(file) as archive:
                is_sound = archive.testzip() is None
        except (OSError, ValueError, zipfile.BadZipFile, zlib.error) as error:
            raise PoolError(f"{file}: damaged ({error})", hint=_FRESH) from error
    if not is_sound:
        raise PoolError(
            f"{file}: damaged, or not the weights that record.json beside it is of", hint=_FRESH
        )


def _stored_weights(file: Path, flat: dict[str, Array]) -> dict[str, np.ndarray]:
    """The arrays of a file of weights, f32, after a look at each; `flat` has the network's, by name."""
    # A damaged archive makes zipfile, zlib and NumPy raise whatever they like.
    try:
        with np.load(file, allow_pickle=False) as stored:
            faults = _wrong_names(set(stored.files), flat)
            # The sizes are looked at before anything is unpacked: a small file may hold terabytes of zeros.
            with zipfile.ZipFile(file) as archive:
                sizes = {
                    each.filename.removesuffix(".npy"): each.file_size
                    for each in archive.infolist()
                }
            known = [name for name in stored.files if name in flat]
            large = [
                name for name in known if sizes[name] > _MOST_BYTES * flat[name].size + _HEADER
            ]
            read = {name: _from_bytes(stored[name]) for name in known if name not in large}
            weights = {
                name: read.get(str(value), value) if value.dtype.kind == "U" else value
                for name, value in read.items()
            }
    except Exception as error:
        raise PoolError(
            f"{file} cannot be read ({type(error).__name__}: {error})", hint=_FRESH
        ) from error
    faults += [
        f"array {name!r} has {sizes[name]} bytes, and the network's is of shape {flat[name].shape}"
        for name in large
    ]
    faults += [
        fault for name, value in weights.items() if (fault := _wrong_array(name, value, flat[name]))
    ]
    if faults:
        more = f"; and {len(faults) - _SHOWN} more" if len(faults) > _SHOWN else ""
        raise PoolError(
            f"{file}: weights of another network, or damaged: {'; '.join(faults[:_SHOWN])}{more}",
            "every array of the actor, finite, of its shape",
            _FRESH,
        )
    return {name: value.astype(np.float32) for name, value in weights.items()}


def _wrong_names(names: set[str], flat: dict[str, Array]) -> list[str]:
    required = {name for name in flat if not name.startswith(_CRITIC)}
    return [f"array {name!r} is missing" for name in sorted(required - names)] + [
        f"array {name!r} is none of the network's" for name in sorted(names - set(flat))
    ]


def _wrong_array(name: str, value: np.ndarray, like: Any) -> str:
    """What is wrong with one array, in words; empty if it is sound."""
    if value.shape != like.shape:
        return f"array {name!r} is of shape {value.shape}, and the network's of {like.shape}"
    if value.dtype not in (np.float16, np.float32):
        return f"array {name!r} is of type {value.dtype}, not float16 or float32"
    if not np.isfinite(value).all():
        return f"array {name!r} holds numbers that are not finite"
    return ""
