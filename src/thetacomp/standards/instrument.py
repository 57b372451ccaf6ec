"""What the measuring instrument adds to the uncertainty of a test result, as far as `campaign.toml` states it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from thetacomp.campaign import CampaignSettings


@dataclass(frozen=True)
class Instrument:
    """Expanded uncertainty (k = 2) of one reading: `u_um` + `u_um_per_m` times the distance. None: not stated."""

    name: str = ""
    u_um: float | None = None
    u_um_per_m: float | None = None

    @classmethod
    def of(cls, settings: CampaignSettings) -> Instrument:
        """The instrument that `campaign.toml` names."""
        return cls(settings.instrument, settings.instrument_u_um, settings.instrument_u_um_per_m)

    def reading_u_um(self, apart_mm: float = 0.0) -> float | None:
        """Expanded uncertainty of one reading at a distance of `apart_mm`, in µm; None where none is stated."""
        return None if self.u_um is None else self.u_um + (self.u_um_per_m or 0.0) * apart_mm / 1000.0

    def difference_u_um(self, apart_mm: float = 0.0) -> float | None:
        """Expanded uncertainty of the difference of two readings at a distance of `apart_mm`, in µm.

        Root of the sum of squares of both readings (GUM, ISO/TR 230-9), the near one at the instrument, the far one
        `apart_mm` away. None where `campaign.toml` states no `instrument_u_um`. The mean of several runs is not
        credited: how much of the uncertainty is common to all runs is not known.
        """
        near_um, far_um = self.reading_u_um(), self.reading_u_um(apart_mm)
        return None if near_um is None or far_um is None else math.hypot(near_um, far_um)

    @property
    def statement(self) -> str:
        """The instrument and its uncertainty in words."""
        if self.u_um is None:
            return "not stated: campaign.toml has no instrument_u_um, so no uncertainty is stated with the results"
        per_m = f" + {self.u_um_per_m:g} µm/m" if self.u_um_per_m else ""
        return f"{self.name or 'instrument'}, U(k = 2) of one reading {self.u_um:g} µm{per_m}"
