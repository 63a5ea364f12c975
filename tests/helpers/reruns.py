"""What Rerun's own reader finds in a file."""

from collections import defaultdict


def columns_of(path):
    """By path of the entity and column the values, a row after another; paths without their escapes."""
    from rerun.chunk import RrdReader

    found = defaultdict(lambda: defaultdict(list))
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            found[chunk.entity_path.replace("\\", "")][name] += batch.column(name).to_pylist()
    return {path: dict(columns) for path, columns in found.items()}
