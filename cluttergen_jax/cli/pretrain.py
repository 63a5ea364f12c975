"""`cluttergen pretrain`: a point encoder that tells shapes apart, for `train --encoder-weights`."""

from __future__ import annotations

from cluttergen_jax.api.pretrain import pretrain
from cluttergen_jax.cli.options import Options, options_from


@options_from(pretrain)
class Pretrain(Options):
    """Pretrain a point encoder by classifying shapes. Rerun to resume.

    The classes are the families of the modeller (those of the five pools), each with many objects of drawn
    proportions; accuracy is that on objects that were not learned from.

    Example: `cluttergen pretrain --encoder pointnet2`
    """

    def run(self) -> int:
        print(f"run        {self.out or f'runs/encoder-{self.encoder}'}")
        report = self.call(pretrain)
        found = f"{report.accuracy:.3f} of {report.num_held_out} shapes of {report.num_families} families"
        print(f"held out   {found} recognised")
        print(f"done       --encoder {self.encoder} --encoder-weights {report.folder}")
        return 0
