"""The one way from a machine folder to the states that models are fitted on: choose, screen, separate, collect.

Every command that trains a model or chooses sensors begins here, so that two commands that look at the same folder see
the same readings, the same form and the same states.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from thetacomp.axis_states import AxisStates, axis_states
from thetacomp.campaign import MachineFolder
from thetacomp.campaign_conditions import condition_notes, refuse_mixtures
from thetacomp.errors import AnalysisError
from thetacomp.reading.clock import clock_notes
from thetacomp.screening.campaigns import ScreenedFolder, screened
from thetacomp.separation import ComponentSeparation, Separated, separate_all
from thetacomp.separation.reference import cold_block_notes

Faults = Literal["repair", "tell", "ignore"]
"""What is done with faulty readings: repaired or left out; only reported; or not even looked for, which is faster."""

Progress = Callable[[str], None]


@dataclass(frozen=True, repr=False)
class Prepared:
    """Measurements of a folder as models are fitted on them.

    `folder` holds the readings as they are used, `screening` what was found faulty in them (None where nobody looked).
    `everything` are the states of all named campaigns, axis by axis with the drift last, `training` those of `train`
    alone. `notes` say what a user of the model has to know of the measurements.
    """

    folder: MachineFolder
    train: tuple[str, ...]
    test: tuple[str, ...]
    screening: ScreenedFolder | None
    separated: Separated
    everything: tuple[AxisStates, ...]
    training: tuple[AxisStates, ...]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        tested = f"; tested on {', '.join(self.test)}" if self.test else ""
        sizes = ", ".join(f"{s.label} {len(s)} states" for s in self.everything)
        return (
            f"Prepared: {self.folder.machine.name or 'machine'}, {len(self.folder.machine.sensors)} sensors,"
            f" {self.separated.form} form\n"
            f"campaigns: {', '.join(self.train)}{tested}\n"
            f"{sizes}"
        )

    @property
    def screening_notes(self) -> tuple[str, ...]:
        """What screening found and did, in words."""
        return self.screening.notes if self.screening is not None else ()

    def without_sensors(self, lost: Collection[str]) -> Prepared:
        """The same measurements as if some sensors had never been read; screening and separation stand."""
        folder = self.folder.without_sensors(lost)
        everything, training = _states(folder, self.separated.components, self.train, self.test)
        return replace(self, folder=folder, everything=everything, training=training)


def prepare(
    folder: MachineFolder,
    train: Sequence[str] = (),
    test: Sequence[str] = (),
    *,
    faults: Faults = "repair",
    mix: bool = False,
    progress: Progress = lambda message: None,
) -> Prepared:
    """Screen, separate in the one form that all campaigns carry, and pair the states with their temperatures.

    `train` and `test` name campaigns; by default all train. `mix` allows campaigns of different operating modes or
    active tables in one model. `progress` receives one line a step. Raises AnalysisError where the campaigns may not
    share a model, where one cannot be separated, or where nothing was measured.
    """
    train, test = _chosen(folder, train, test)
    mixed = refuse_mixtures([folder.campaign(name) for name in (*train, *test)], mix)
    screening: ScreenedFolder | None = None
    if faults != "ignore":
        progress("screening temperatures")
        screening = screened(folder, train, test, repair=faults == "repair")
        folder = screening.folder
    campaigns = [folder.campaign(name) for name in (*train, *test)]
    progress("separating geometry and heat")
    separated = separate_all(folder.machine, campaigns)
    if not separated.components:
        raise AnalysisError(
            "there are no sweeps, parameters or drift in the chosen campaigns: nothing to model."
            " Fix: put sweeps.csv, parameters.csv or drift.csv into a campaign."
        )
    everything, training = _states(folder, separated.components, train, test)
    measured = [
        *condition_notes(campaigns),
        *clock_notes(campaigns),
        *(note for campaign in campaigns for note in cold_block_notes(campaign)),
    ]
    measured += [f"campaign {s.campaign}, {s.component}: {note}" for s in separated.components for note in s.notes]
    notes = (*mixed, *dict.fromkeys(measured), *separated.notes, *_dropped_notes(separated.components, everything))
    return Prepared(
        folder=folder,
        train=tuple(train),
        test=tuple(test),
        screening=screening,
        separated=separated,
        everything=everything,
        training=training,
        notes=notes + (screening.notes if screening is not None else ()),
    )


def _chosen(folder: MachineFolder, train: Sequence[str], test: Sequence[str]) -> tuple[list[str], list[str]]:
    known = [campaign.name for campaign in folder.campaigns]
    unknown = [name for name in (*train, *test) if name not in known]
    if unknown:
        raise AnalysisError(
            f"there is no campaign {', '.join(unknown)}; the folder has {', '.join(known)}."
            " Fix: use these names with --train and --test."
        )
    twice = sorted({name for names in (train, test) for name in names if list(names).count(name) > 1})
    if twice:
        raise AnalysisError(f"campaign {', '.join(twice)} is named twice. Fix: name every campaign once.")
    both = sorted(set(train) & set(test))
    if both:
        raise AnalysisError(f"campaign {', '.join(both)} is named in --train and in --test. Fix: name it once.")
    # In the order of the folder, which is the order of time for the forward split.
    chosen = [name for name in known if name in set(train or known) and name not in set(test)]
    if not chosen:
        raise AnalysisError("no campaign is left for training. Fix: leave one out of --test.")
    return chosen, [name for name in known if name in set(test)]


def _states(
    folder: MachineFolder, components: Sequence[ComponentSeparation], train: Sequence[str], test: Sequence[str]
) -> tuple[tuple[AxisStates, ...], tuple[AxisStates, ...]]:
    """States of all named campaigns, and those of the training campaigns."""
    everything = axis_states(folder, components, [*train, *test])
    return everything, axis_states(folder, components, train) if test else everything


def _dropped_notes(separations: Sequence[ComponentSeparation], everything: Sequence[AxisStates]) -> tuple[str, ...]:
    """Components that were measured in some campaigns of their axis only: they are not in the model."""
    kept = {component for states in everything for component in states.components}
    measured: dict[str, list[str]] = {}
    for s in separations:
        measured.setdefault(s.component, []).append(s.campaign)
    return tuple(
        f"{component} was measured in {', '.join(names)} only, not in all campaigns of its axis: it is not modelled"
        for component, names in measured.items()
        if component not in kept
    )
