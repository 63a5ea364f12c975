"""The suites: which studies each holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from cluttergen_jax.errors import ConfigError, closest
from studies.downstream.perception import PERCEPTION
from studies.downstream.placement import CAMERAS, NOISE, PLACEMENT
from studies.downstream.robot import REARRANGEMENT, REARRANGEMENT_ABLATIONS, ROBOT
from studies.downstream.trained import (
    PROTOCOL,
    SET_SIZE,
    SOURCE,
    TRAINING_SEEDS,
    TRANSFER,
)
from studies.methods.clutter_targets import CLUTTER_TARGETS
from studies.methods.density import CROWDS, DENSITY
from studies.methods.diversity import ACCEPTANCE, DIVERSITY, DIVERSITY_MAPS
from studies.methods.front import FRONT
from studies.methods.held_out import HELD_OUT_OBJECTS
from studies.methods.paper_figures import (
    ATTEMPTS,
    FIG1A,
    LEARNING_CURVES,
    STEPS_BY_ATTEMPT,
)
from studies.methods.pictures import CLOSED_LOOP
from studies.methods.relations import RELATIONS
from studies.methods.robust_scenes import STABILITY
from studies.methods.robustness import (
    MARGIN,
    MARGIN_SURVIVAL,
    ROBUSTNESS,
    SURVIVAL,
)
from studies.methods.table1 import IMPORTED, IMPORTED_GROUPS, TABLE1
from studies.methods.tables import TABLE2, TABLE_TOPS, TABLES
from studies.methods.time import TIME
from studies.study import Scale, Study, of_methods

DOWNSTREAM = "downstream"
"""The suite whose studies make and keep their rows themselves, in a `SuiteFolder`."""
# Times are measured in processes of their own, after everything else.
SUITES: dict[str, tuple[Study, ...]] = {
    "paper": (
        TABLE1,
        IMPORTED_GROUPS,
        FIG1A,
        STEPS_BY_ATTEMPT,
        DIVERSITY_MAPS,
        CLOSED_LOOP,
        LEARNING_CURVES,
        ATTEMPTS,
        TABLE2,
        TABLES,
        TABLE_TOPS,
        RELATIONS,
    ),
    "extended": (
        FRONT,
        DENSITY,
        CROWDS,
        HELD_OUT_OBJECTS,
        DIVERSITY,
        ACCEPTANCE,
        ROBUSTNESS,
        SURVIVAL,
        MARGIN,
        MARGIN_SURVIVAL,
        STABILITY,
        CLUTTER_TARGETS,
        TIME,
    ),
    DOWNSTREAM: (
        PLACEMENT,
        NOISE,
        CAMERAS,
        SET_SIZE,
        SOURCE,
        TRAINING_SEEDS,
        TRANSFER,
        PROTOCOL,
        PERCEPTION,
        ROBOT,
        REARRANGEMENT,
        REARRANGEMENT_ABLATIONS,
    ),
}
"""The paper's tables and figures in its order, what the paper does not ask, and what scenes are good for."""
STUDIES = {study.name: study for studies in SUITES.values() for study in studies}


@dataclass(frozen=True)
class PlannedStudy:
    """A study and its trials at some scale."""

    study: Study
    trials: Sequence[Any]

    @property
    def name(self) -> str:
        """The study's."""
        return self.study.name


def find_suite(suite: str, scale: Scale, only: Sequence[str] = ()) -> tuple[PlannedStudy, ...]:
    """The studies of a suite, or those of them that are named.

    Raises:
      ConfigError: there is no such suite, no such study in it, or nothing is left to be made.
    """
    if suite not in SUITES:
        raise ConfigError(
            f"suite = {suite!r}", ", ".join(SUITES), 'suite="paper"', closest(suite, SUITES)
        )
    names = [study.name for study in SUITES[suite]]
    for each in only:
        if each not in names:
            raise ConfigError(
                f"only = {each!r} in suite {suite!r}",
                ", ".join(names),
                f'only="{names[0]}"',
                closest(each, names),
            )
    named = [study for study in SUITES[suite] if not only or study.name in only]
    planned = [PlannedStudy(study, trials) for study in named if (trials := study.trials(scale))]
    if not planned:
        raise ConfigError(
            f"only = {', '.join(only)!r} without such a pool",
            f"pools of the paper's objects whose names begin with {IMPORTED}",
            f"cluttergen import GROUP --pool {IMPORTED}dining",
        )
    if not scale.methods:
        return tuple(planned)
    kept = [PlannedStudy(each.study, of_methods(each.trials, *scale.methods)) for each in planned]
    if not any(each.trials for each in kept):
        known = dict.fromkeys(trial.method for each in planned for trial in each.trials)
        raise ConfigError(
            f"methods = {', '.join(scale.methods)!r} with suite {suite!r}", ", ".join(known)
        )
    return tuple(each for each in kept if each.trials)
