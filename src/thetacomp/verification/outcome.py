"""What a verification gives: before and after with its uncertainty, the share that was applied, checks and causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from thetacomp.arrays import Floats
from thetacomp.machine import Machine

ShareKind = Literal["applied", "reversed", "doubled", "not active", "partly", "too strong", "unclear"]
CauseKind = Literal[
    "reversed", "doubled", "not active", "partly", "too strong", "mode", "relation", "tables", "heat", "model"
]
STATISTICS = ("max", "p95", "rms")


@dataclass(frozen=True)
class Statistic:
    """One figure of an error, off and on, in µm. `kind` is max, p95 or rms.

    `like_before_um` is the uncompensated figure brought to the heat of the run with compensation on; `reduction`
    compares the runs as measured, `like_reduction` at the same heat. `low_percent` and `high_percent` bound the latter
    (95 %). NaN where no temperature explains the error of the run with compensation off.
    """

    kind: str
    before_um: float
    like_before_um: float
    after_um: float
    reduction_percent: float
    like_reduction_percent: float
    low_percent: float
    high_percent: float


@dataclass(frozen=True)
class BeforeAfter:
    """An error component, or `column_X`, `column_Z` for the column deviation, with its statistics max, p95, rms."""

    component: str
    states_off: int
    states_on: int
    statistics: tuple[Statistic, ...]

    def of(self, kind: str) -> Statistic:
        """The statistic max, p95 or rms."""
        return next(s for s in self.statistics if s.kind == kind)


@dataclass(frozen=True)
class Share:
    """Which share of the wanted correction reached one component, with its 95 % interval: 1 is right, -1 reversed.

    `part` is "all", "intercept" or "slope"; `size_um` the largest uncompensated error of that part at the heat of the
    run with compensation on. `expected_rms_um` is the RMS of that error of the whole component, `unexplained_um` the
    RMS that no constant share explains, `usual_um` the same with compensation off, and at least what the law leaves of
    campaigns that it has not seen. `material` says that the part is large enough to judge. `sd` is the standard
    deviation of the share, known with `freedom` degrees of freedom. `usual_um` and `sd` are NaN where the law comes
    from one campaign and the heat of the runs followed another course. `chance` is the largest ratio of
    `unexplained_um` to `usual_um` that few sweeps make by chance.
    """

    component: str
    part: str
    value: float
    low: float
    high: float
    size_um: float
    expected_rms_um: float
    unexplained_um: float
    usual_um: float
    material: bool
    kind: ShareKind
    sd: float
    freedom: float
    chance: float


@dataclass(frozen=True)
class PooledShare:
    """The applied share of several components taken together, with its 95 % interval.

    `named` are those of its `components` whose own interval cannot decide and whose share lies near this kind.
    """

    components: tuple[str, ...]
    value: float
    low: float
    high: float
    kind: ShareKind
    named: tuple[str, ...]


@dataclass(frozen=True)
class HarmMap:
    """|residual| less |uncompensated error at the same heat| in µm, (states, positions); NaN: not measured.

    `t_s` (states,) and `position_mm` (positions,); drift has one position. `limit_um` is what a check allows.
    """

    component: str
    t_s: Floats
    position_mm: Floats
    harm_um: Floats
    limit_um: float
    largest_um: float
    largest_at_s: float
    largest_at_mm: float


@dataclass(frozen=True)
class Straightness:
    """ISO 230-1 straightness of a motion, geometry included, in µm peak to valley: cold, warmest off, warmest on.

    `line` is the reference line: "least squares" or "end points". A pure tilt vanishes here.
    """

    component: str
    line: str
    cold_off_um: float
    cold_on_um: float
    off_um: float
    on_um: float


@dataclass(frozen=True)
class Squareness:
    """Largest thermal change against the cold reference, in µrad, off and on.

    `name` is a component (tilt of its own line) or two axes such as "X-Y" (change of the angle between them).
    """

    name: str
    off_urad: float
    on_urad: float


@dataclass(frozen=True)
class RunFacts:
    """Conditions of one run: campaigns, hours, reference temperature (mean of the sensors), largest rises in K."""

    campaigns: tuple[str, ...]
    mode: str
    tables: tuple[str, ...]
    instrument: str
    hours: float
    heated_sweeps: int
    start_degC: float
    rises_K: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Check:
    """One named check of the verdict: what was found and what is required, in words with units."""

    name: str
    passed: bool
    found: str
    required: str


@dataclass(frozen=True)
class Cause:
    """Why the verdict is no-go: a sentence with figures, and what to do."""

    kind: CauseKind
    components: tuple[str, ...]
    text: str
    fix: str


@dataclass(frozen=True)
class StateLine:
    """The largest |error| over the travel at every state of one run, in µm, with the time and the expected error."""

    component: str
    t_s: Floats
    largest_um: Floats
    expected_um: Floats


@dataclass(frozen=True)
class VerificationResult:
    """Everything the verification page shows. `heat_ratio` is heat on / heat off in terms of expected error.

    `states_off` and `states_on` draw the error against the heat. `pattern` says where the expected uncompensated
    error comes from.
    """

    machine: Machine
    off: RunFacts
    on: RunFacts
    pattern: str
    heat_ratio: float
    rows: tuple[BeforeAfter, ...]
    shares: tuple[Share, ...]
    pooled: tuple[PooledShare, ...]
    harm: tuple[HarmMap, ...]
    straightness: tuple[Straightness, ...]
    squareness: tuple[Squareness, ...]
    states_off: tuple[StateLine, ...]
    states_on: tuple[StateLine, ...]
    checks: tuple[Check, ...]
    causes: tuple[Cause, ...]
    notes: tuple[str, ...]

    @property
    def go(self) -> bool:
        """True where every check is passed."""
        return all(check.passed for check in self.checks)

    @property
    def verdict(self) -> str:
        """GO or NO-GO in words; a go says how many notes limit it."""
        count = len(self.notes)
        limited = f" WITH {count} NOTE{'S' if count > 1 else ''}" if count else ""
        return f"GO{limited}" if self.go else "NO-GO"


def listed(names: Sequence[str]) -> str:
    """Names in one line; "none" where there are none."""
    return ", ".join(names) or "none"
