"""Records of JSON as files of earlier versions have them."""

from typing import Any

from cluttergen_jax.schema import CHECKSUM

_CHECKSUMS = (CHECKSUM, "weights_sha256", "files")


def unsigned(record: dict[str, Any]) -> dict[str, Any]:
    """The record without its checksums."""
    return {
        name: value
        for name, value in record.items()
        if name not in (CHECKSUM, "weights_sha256", "files")
    }
