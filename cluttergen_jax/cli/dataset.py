"""`cluttergen dataset`: what cameras see of the scenes of banks, in files for trainers."""

from __future__ import annotations

from tyro.conf import Positional

from cluttergen_jax.api.dataset import make_dataset
from cluttergen_jax.cli.options import Options, options_from


@options_from(make_dataset, banks=Positional[tuple[str, ...]])
class Dataset(Options):
    """Make a dataset of views of banks: colour, depth, labels, masks, poses. Rerun to resume.

    Example: `cluttergen dataset bank --cameras free:4 --size 320x240 --splits train=0.9,test=0.1`
    """

    def run(self) -> int:
        print(self.call(make_dataset))
        return 0
