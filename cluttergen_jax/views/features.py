"""What the library `datasets`, and hubs with it, makes of the columns of a Parquet file.

Its rule (`Features.from_arrow_schema`): the schema's metadata has under `huggingface` a JSON text, in which
`info.features` names for each column a feature; it counts where the column's type is the feature's own. That
of an image is a struct of `bytes` and `path`. A dataset card says the same in its YAML (`dataset_info`).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import pyarrow as pa

IMAGE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
"""The type of an image: the bytes of its file."""
_KEY = b"huggingface"
_WORDS = {"double": "float64", "float": "float32"}
"""Its words for types, where they are not Arrow's."""


def with_features(fields: Sequence[tuple[str, pa.DataType]]) -> pa.Schema:
    """The schema of these columns, with what each is to `datasets` in its metadata."""
    features = {name: _feature(kind) for name, kind in fields}
    told = json.dumps({"info": {"features": features}})
    return pa.schema(fields, metadata={_KEY: told.encode()})


def has_features_of(found: pa.Schema, wanted: pa.Schema) -> bool:
    """Whether a file's schema has the columns of one of `with_features`, and says the same of them."""
    says_the_same = (found.metadata or {}).get(_KEY) == wanted.metadata[_KEY]
    return bool(found.equals(wanted) and says_the_same)


def card_features(schema: pa.Schema) -> list[dict[str, Any]]:
    """The same as a dataset card lists them: `name`, and `dtype` or `sequence`."""
    return [{"name": field.name, **_card_feature(field.type)} for field in schema]


def _feature(kind: pa.DataType) -> dict[str, Any]:
    if kind == IMAGE:
        return {"_type": "Image"}
    if not _is_list(kind):
        return {"dtype": _word(kind), "_type": "Value"}
    # Versions before 4 have this word for lists, and later ones read it.
    return {"feature": _feature(kind.value_type), **_length(kind), "_type": "Sequence"}


def _card_feature(kind: pa.DataType) -> dict[str, Any]:
    if not _is_list(kind):
        return {"dtype": "image" if kind == IMAGE else _word(kind)}
    inner = _card_feature(kind.value_type)
    return {"sequence": inner.get("dtype", inner), **_length(kind)}


def _is_list(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind))


def _length(kind: pa.DataType) -> dict[str, int]:
    return {"length": kind.list_size} if pa.types.is_fixed_size_list(kind) else {}


def _word(kind: pa.DataType) -> str:
    return _WORDS.get(str(kind), str(kind))
