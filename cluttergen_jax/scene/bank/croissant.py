"""A bank's rows as Croissant 1.0 describes data sets (docs.mlcommons.org/croissant): `croissant.json`.

The files of rows are a file set of the folder in which the description lies, their columns the fields of one
record set. Digests are in `bank.json`. Programs that know Croissant read rows from it; hubs and search
engines what the data set is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from cluttergen_jax.files import write_atomically

CROISSANT = "croissant.json"
_ABOUT = "Cluttered tabletop scenes, made by cluttergen_jax: objects that stand on a support in simulation."
"""The beginning of the description, by which one that may be written again is known."""
_TERMS = (
    "citeAs",
    "column",
    "conformsTo",
    "data",
    "dataType",
    "equivalentProperty",
    "examples",
    "extract",
    "field",
    "fileObject",
    "fileProperty",
    "fileSet",
    "format",
    "includes",
    "isLiveDataset",
    "jsonPath",
    "key",
    "md5",
    "parentField",
    "path",
    "recordSet",
    "references",
    "regex",
    "repeated",
    "replace",
    "samplingRate",
    "separator",
    "source",
    "subField",
    "transform",
)
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "sc": "https://schema.org/",
    **{term: f"cr:{term}" for term in _TERMS},
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
}
"""What Croissant asks for, word for word: readers warn of another."""
_VERSION = "http://mlcommons.org/croissant/1.0"
_ROWS = "rows"
_SCENES = "scenes"


def write_croissant(
    folder: Path, schema: pa.Schema, columns: Mapping[str, str], licences: Sequence[str], title: str
) -> Path | None:
    """Writes the description, unless the user has one of their own there; its path if written.

    Args:
      schema: of the rows. columns: what each column holds, in words.
      licences: of the assets. title: of the data set.
    """
    path = folder / CROISSANT
    if path.exists() and _ABOUT not in path.read_text(encoding="utf-8", errors="replace"):
        return None
    text = json.dumps(_description(schema, columns, licences, title), indent=1)
    write_atomically(path, f"{text}\n".encode())
    return path


def _description(
    schema: pa.Schema, columns: Mapping[str, str], licences: Sequence[str], title: str
) -> dict[str, Any]:
    rows = {
        "@type": "cr:FileSet",
        "@id": _ROWS,
        "name": _ROWS,
        "description": "A row for each scene, failures included.",
        "encodingFormat": "application/x-parquet",
        "includes": "scenes-*.parquet",
    }
    scenes = {
        "@type": "cr:RecordSet",
        "@id": _SCENES,
        "name": _SCENES,
        "field": [_field(field, columns[field.name]) for field in schema],
    }
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": _VERSION,
        "name": title,
        "description": _ABOUT,
        "license": sorted(set(licences)),
        "version": "1.0.0",
        "distribution": [rows],
        "recordSet": [scenes],
    }


def _field(field: pa.Field, about: str) -> dict[str, Any]:
    kind = field.type
    repeated = {}
    while pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind):
        kind = kind.value_type
        repeated = {"repeated": True}
    return {
        "@type": "cr:Field",
        "@id": f"{_SCENES}/{field.name}",
        "name": field.name,
        "description": about,
        "dataType": _data_type(kind),
        **repeated,
        "source": {"fileSet": {"@id": _ROWS}, "extract": {"column": field.name}},
    }


def _data_type(kind: pa.DataType) -> str:
    if pa.types.is_boolean(kind):
        return "sc:Boolean"
    if pa.types.is_integer(kind):
        return "sc:Integer"
    if pa.types.is_floating(kind):
        return "sc:Float"
    return "sc:Text"
