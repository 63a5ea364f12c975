"""Makes the embedded pools again: python scenes/build.py (a few minutes, the same bytes each time)."""

from pathlib import Path

from cluttergen_jax.importing.embedded import build_scenes

if __name__ == "__main__":
    build_scenes(Path(__file__).parent / "pools")
