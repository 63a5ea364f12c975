"""Small files of the kinds that an import gets wrong."""

from pathlib import Path

CASES = Path(__file__).parents[1] / "cases" / "import"
READERS = Path(__file__).parents[1] / "cases" / "readers"
"""Files that killed or stopped their readers."""
