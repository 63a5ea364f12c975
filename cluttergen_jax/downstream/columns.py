"""Columns of Parquet tables as arrays, and checks of what was read."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pyarrow as pa

from cluttergen_jax.schema import Numbers, SchemaError, check_numbers

MOST_PIXELS = 4096
"""Of an image's side."""
FAR = 100.0
"""Metres beyond which nothing of a table's scene is."""
_UNIT = 1e-3
"""By which the length of a quaternion may differ from 1."""


def read_columns(table: pa.Table, numbers: Mapping[str, Numbers]) -> dict[str, np.ndarray]:
    """Columns of a block as arrays (`numbers_of`).

    Raises:
      SchemaError: a number is missing, not finite or out of its range.
    """
    found = {name: numbers_of(table, name) for name in numbers}
    check_numbers(found, numbers)
    return found


def numbers_of(table: pa.Table, name: str) -> np.ndarray:
    """A column of numbers or texts as an array; lists are flattened, a fixed size is that of the last axis.

    Raises:
      SchemaError: a value is missing.
    """
    values = table[name].combine_chunks()
    last = list[int]()
    while True:
        if values.null_count:
            raise SchemaError(f"{name!r} lacks a value")
        if pa.types.is_fixed_size_list(values.type):
            last = [values.type.list_size]
        elif not pa.types.is_list(values.type):
            break
        values = values.flatten()
    return values.to_numpy(zero_copy_only=False).reshape(-1, *last)


def lengths_of(table: pa.Table, name: str) -> np.ndarray:
    """i64[R]: how many entries, or bytes, each row of a column has; -1 where there is none."""
    column = table[name].combine_chunks()
    is_list = pa.types.is_list(column.type)
    found = (pa.compute.list_value_length if is_list else pa.compute.binary_length)(column)
    return found.cast(pa.int64()).fill_null(-1).to_numpy()


def faults_of(table: pa.Table, lengths: Mapping[str, np.ndarray], *poses: np.ndarray) -> list[str]:
    """What is wrong with lengths i[R] of columns, and with quaternions of poses f[..., 7]."""
    faults = [
        f"{name!r} is not as long as it should be"
        for name, length in lengths.items()
        if not np.array_equal(lengths_of(table, name), length)
    ]
    turns = np.concatenate([np.linalg.norm(each[:, 3:], axis=1) for each in poses])
    return faults + ["a quaternion is not of length 1"] * bool(
        np.abs(turns - 1).max(initial=0) > _UNIT
    )
