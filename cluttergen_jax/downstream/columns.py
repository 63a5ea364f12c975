"""Columns of a data set's rows as arrays, for the checks of what was read."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from cluttergen_jax.schema import SchemaError


def numbers_of(table: pa.Table, name: str, *lengths: int) -> np.ndarray:
    """A column, of numbers or texts, as an array; lists of lists are flattened down to `lengths`.

    Args:
      lengths: of the inner axes, of which the first may be -1.

    Raises:
      SchemaError: a value is missing.
    """
    values = table[name].combine_chunks()
    while True:
        if values.null_count:
            raise SchemaError(f"{name!r} lacks a value")
        if not (pa.types.is_list(values.type) or pa.types.is_fixed_size_list(values.type)):
            break
        values = values.flatten()
    return values.to_numpy(zero_copy_only=False).reshape(-1, *lengths)


def lengths_of(table: pa.Table, name: str) -> np.ndarray:
    """i64[R]: how many entries, or bytes, each row of a column has; -1 where there is none."""
    column = table[name].combine_chunks()
    is_list = pa.types.is_list(column.type)
    found = (pa.compute.list_value_length if is_list else pa.compute.binary_length)(column)
    return found.cast(pa.int64()).fill_null(-1).to_numpy()


def labels_fault(table: pa.Table, name: str, most: np.ndarray) -> str:
    """What is wrong with images of labels u8, of which each row allows up to `most`, i[R]; "" if nothing."""
    for image, allowed in zip(table[name], most.tolist(), strict=True):
        if np.frombuffer(image.as_buffer(), np.uint8).max(initial=0) > allowed:
            return f"{name!r} holds a label beyond {allowed}"
    return ""
