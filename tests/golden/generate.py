"""Whether `generate` still makes the scenes that commit 5ccd90d made, bit for bit: on its machine, with its versions.

    python tests/golden/generate.py        # a few minutes; generate.json holds what was made, and on what

Scenes of equal seeds may differ on another machine (docs/contract.md, "Determinism"), so this is no test.
"""

import hashlib
import itertools
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import pyarrow.parquet as pq

HERE = Path(__file__).parent
COLUMNS = ("index", "is_success", "object_index", "poses", "attempts", "steps", "verdict")
METHODS = ("random", "clear", "drop", "policy")


def digest(method: str, pool: str, support: str) -> str:
    """Hex digest of 64 scenes by the paper's rules."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "cluttergen_jax", "generate", "--out", f"{folder}/bank", "-n", "64"]
        command += ["--max-files", "0", "--setting", "paper"]
        command += ["--pool", pool, "--support", support, "--method", method]
        subprocess.run(command, check=True, capture_output=True)
        found = hashlib.sha256()
        for file in sorted(Path(folder, "bank").glob("scenes-*.parquet")):
            table = pq.read_table(file)
            for name in COLUMNS:
                found.update(json.dumps(table[name].to_pylist()).encode())
    return found.hexdigest()


if __name__ == "__main__":
    expected = json.loads((HERE / "generate.json").read_text())["scenes"]
    wrong = 0
    for words in itertools.product(METHODS, ("dining", "household"), ("table", "table-0.40x0.50")):
        is_equal = digest(*words) == expected["/".join(words)]
        wrong += not is_equal
        print(*words, "equal" if is_equal else "DIFFERENT", flush=True)
    sys.exit(wrong > 0)
