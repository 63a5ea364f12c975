"""The numbers of a glTF file: quantised, sparse, or compressed by Draco, as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

from cluttergen_jax.errors import AssetError
from cluttergen_jax.importing.readers.gltf_extensions import DRACO
from cluttergen_jax.importing.readers.gltf_file import Buffers, Document

_DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


class Arrays:
    """Accessors of a glTF file as arrays.

    Args:
      document: the file's JSON. buffers: its bytes.
    """

    def __init__(self, document: Document, buffers: Buffers) -> None:
        self._document, self._buffers = document, buffers

    def accessor(self, index: int, raw: np.ndarray | None = None) -> np.ndarray:
        """[N, width]: an accessor's elements; floats in [-1, 1] where its integers are normalised.

        Args:
          raw: its elements, where they come from elsewhere.
        """
        accessor = self._document["accessors"][index]
        array = self._dense(accessor) if raw is None else raw
        array = self._with_sparse(array, accessor["sparse"]) if "sparse" in accessor else array
        if accessor.get("normalized") and array.dtype.kind in "iu":
            return np.maximum(array / np.iinfo(np.dtype(_DTYPES[accessor["componentType"]])).max, -1.0)
        return array

    def primitive(self, primitive: dict[str, Any]) -> tuple[dict[str, np.ndarray], np.ndarray | None]:
        """The attributes of a primitive by name, and its indices i[M] if it has any."""
        attributes, indices = primitive["attributes"], None
        raw: dict[str, np.ndarray] = {}
        compressed = primitive.get("extensions", {}).get(DRACO)
        if compressed is not None and not self._has_bytes(attributes["POSITION"]):
            raw, indices = self._draco(compressed)
        arrays = {name: self.accessor(index, raw.get(name)) for name, index in attributes.items()}
        if indices is None and "indices" in primitive:
            indices = self.accessor(primitive["indices"]).reshape(-1)
        return arrays, indices

    def _has_bytes(self, index: int) -> bool:
        return "bufferView" in self._document["accessors"][index]

    def _dense(self, accessor: dict[str, Any]) -> np.ndarray:
        shape = accessor["count"], _WIDTHS[accessor["type"]]
        if "bufferView" not in accessor:
            return np.zeros(shape, _DTYPES[accessor["componentType"]])
        stride = self._document["bufferViews"][accessor["bufferView"]].get("byteStride", 0)
        return self._read(accessor["bufferView"], accessor, shape, stride)

    def _read(self, view: int, where: dict[str, Any], shape: tuple[int, int], stride: int = 0) -> np.ndarray:
        dtype, data = np.dtype(_DTYPES[where["componentType"]]), self._buffers.view(view)
        strides = stride or dtype.itemsize * shape[1], dtype.itemsize
        return np.ndarray(shape, dtype, data, where.get("byteOffset", 0), strides).copy()

    def _with_sparse(self, array: np.ndarray, sparse: dict[str, Any]) -> np.ndarray:
        """The array with the elements replaced that are stored beside it."""
        places, values = sparse["indices"], sparse["values"]
        index = self._read(places["bufferView"], places, (sparse["count"], 1))[:, 0]
        new = {**values, "componentType": next(k for k, v in _DTYPES.items() if array.dtype == np.dtype(v))}
        array = array.copy()
        array[index] = self._read(values["bufferView"], new, (sparse["count"], array.shape[1]))
        return array

    def _draco(self, compressed: dict[str, Any]) -> tuple[dict[str, np.ndarray], np.ndarray]:
        try:
            import DracoPy
        except ImportError as error:
            raise AssetError(f"{self._buffers.path} with {DRACO}", hint="pip install DracoPy") from error
        decoded = DracoPy.decode(self._buffers.view(compressed["bufferView"]))
        by_id = {each["unique_id"]: _columns(each["data"]) for each in decoded.attributes}
        arrays = {name: by_id[index] for name, index in compressed["attributes"].items() if index in by_id}
        return arrays, np.asarray(decoded.faces).reshape(-1)


def _columns(values: Any) -> np.ndarray:
    array = np.asarray(values)
    return array.reshape(len(array), -1)
