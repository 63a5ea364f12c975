"""Training of a placer for what a camera sees."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from cluttergen_jax.config import MAX_PAIRS, PlacerHead, PlacerLoss, PlacerNoise, PlacerPreset, check_range
from cluttergen_jax.numerics import with_own_settings


@with_own_settings
def placer_train(
    data: str | Path | Sequence[str | Path],
    head: PlacerHead = "scored",
    out: str | Path | None = None,
    *,
    preset: PlacerPreset = "cpu",
    noise: PlacerNoise = "both",
    num_pairs: int | None = None,
    num_epochs: int | None = None,
    batch_size: int | None = None,
    learning_rate: float | None = None,
    loss: PlacerLoss = "printed",
    encoder_weights: str | Path | None = None,
    seed: int = 0,
    show: Callable[[str], None] = print,
) -> Path:
    """Trains a placer on pairs (`cluttergen placer train`). The same call takes an interrupted run up again.

    Args:
      data: a folder of `placer data`, or several; one network learns from all. Validated on the split `val`
        where there is one, else on every tenth scene of the training split.
      head: "scored" (candidates of a search, each with the chance that it stands), "mixture" (a distribution
        over cells and turns of the region) or "regression" (the paper's: one pose).
      out: the run's folder; runs/placer-HEAD-SEED if not given.
      preset: "cpu", or of "regression" also "paper": as printed, for a GPU.
      noise: of the camera: "on", "off", or "both": every other pair is seen with noise.
      num_pairs: of each folder the first so many; all if not given.
      num_epochs: times that every pair is seen; the preset's if not given.
      batch_size: pairs per step; the preset's if not given.
      learning_rate: of the optimiser, at its highest; the preset's if not given.
      loss: of "regression": "printed", or "symmetric", for which a whole turn makes no difference.
      encoder_weights: of "regression": folder of `pretrain` that both encoders begin with.
      seed: of weights, order and noise, 0 to 4294967295.
      show: is given the lines that tell how far the run is.

    Returns:
      The placer's folder: `find_placer` and `placer_eval` take it.

    Raises:
      ConfigError: a setting is out of range, there are no pairs, or the folder holds another run.
      BankError: a folder holds no pairs, or damaged ones.
      PoolError: `encoder_weights` does not hold what the encoders need.
      KeyboardInterrupt: on Ctrl-C, once everything is saved.
    """
    from cluttergen_jax.downstream.placer.training.examples import ExampleSource
    from cluttergen_jax.downstream.placer.training.presets import preset as preset_of
    from cluttergen_jax.downstream.placer.training.run import PlacerTraining

    check_range("seed", seed, 0, 2**32 - 1, 0)
    if num_pairs is not None:
        check_range("num_pairs", num_pairs, 1, MAX_PAIRS, 5000)
    folders = (data,) if isinstance(data, str | Path) else tuple(data)
    weights = None if encoder_weights is None else Path(encoder_weights)
    found, config = preset_of(
        head,
        preset,
        loss,
        weights,
        num_epochs=num_epochs,
        batch_size=batch_size,
        learning_rate=learning_rate,
        seed=seed,
    )
    source = ExampleSource(tuple(Path(each) for each in folders), noise, seed, num_pairs)
    folder = Path(out or f"runs/placer-{head}-{seed}")
    show(f"run        {folder}")
    return PlacerTraining(found, config, source, folder, show).run()
