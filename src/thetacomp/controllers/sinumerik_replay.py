"""SINUMERIK: the temperatures of a measured campaign through writer, registers and limits of the control.

The writer (PLC) updates, clamps, rounds and ramps; the control adds the change in steps of an interpolation cycle, at
most MD32000 · MD32760 (temperature) or MD32000 · MD32730 (sag), and clamps the sum of the sag tables at MD32720
(SINUMERIK Extended Functions, K3 Compensations, 03/2013).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from thetacomp.arrays import Floats
from thetacomp.controllers.base import RegisterLaw
from thetacomp.controllers.replay import (
    Loss,
    Register,
    Stage,
    clip,
    hold_gaps,
    moving_average,
    outcome,
    quantise,
    rate_limit,
    replay,
    sample_and_hold,
)
from thetacomp.controllers.sinumerik import RegisterPlan, SagTable, plan_registers
from thetacomp.controllers.sinumerik_settings import SinumerikSettings
from thetacomp.errors import AnalysisError
from thetacomp.model.document import ModelDocument

UPDATE, CLAMP, ENTRY, ROUNDING = "update of the writer", "clamp of the writer", "largest entry", "rounding"
FILTER, RAMP, STEP, SUM, SUM_STEP = (
    "filter",
    "ramp of the writer",
    "MD32760, step a cycle",
    "MD32720, sum",
    "MD32730, change of the sum",
)


@dataclass(frozen=True)
class CampaignReplay:
    """One campaign through the limits: losses by register and cause, and the series in µm at the worst position.

    `t_s` (n,); `wanted_um` and `got_um` (registers, n); `registers` names the rows. `fastest_um_per_s` is the change
    that the axis motion itself asks of each axis' compensation, `allowed_um_per_s` what the control gives.
    """

    campaign: str
    losses: tuple[Loss, ...]
    registers: tuple[str, ...]
    t_s: Floats
    wanted_um: Floats
    got_um: Floats
    motion: tuple[MotionCheck, ...]


@dataclass(frozen=True)
class MotionCheck:
    """How fast the compensation changes while the axis moves at MD32000, and what the control allows."""

    register: str
    needed_um_per_s: float
    allowed_um_per_s: float

    @property
    def holds(self) -> bool:
        """True where the control follows the moving axis."""
        return self.needed_um_per_s <= self.allowed_um_per_s


def replay_campaign(
    model: ModelDocument,
    settings: SinumerikSettings,
    campaign: str,
    t_s: Floats,
    temperature_degC: Mapping[str, Floats],
) -> CampaignReplay:
    """Replay one campaign: sensor -> (n,) at the evenly spaced `t_s` (n,), of which the first is the moment of zero.

    Raises AnalysisError where a sensor of the model has no value at that moment.
    """
    sized = plan_registers(model, settings)
    lacking = [s for s in sized.grid_degC if s not in temperature_degC or not np.isfinite(temperature_degC[s][0])]
    if lacking:
        raise AnalysisError(
            f"campaign {campaign}: {', '.join(lacking)} has no value at the reference ({t_s[0]:.0f} s), so it"
            " cannot be replayed. Fix: complete its temperatures, or name a folder whose campaigns have these sensors."
        )
    degC = {sensor: temperature_degC[sensor] for sensor in sized.grid_degC}
    reference = {sensor: float(value[0]) for sensor, value in degC.items()}
    plan = plan_registers(model, settings.model_copy(update={"reference_degC": reference}))
    registers = _registers(plan, sized, settings, degC, len(t_s))
    return CampaignReplay(
        campaign=campaign,
        losses=replay(t_s, registers),
        registers=tuple(f"{register.name} of {register.axis}" for register in registers),
        t_s=t_s,
        wanted_um=np.array([r.wanted * r.um_per_unit for r in registers]),
        got_um=np.array([outcome(t_s, r) * r.um_per_unit for r in registers]),
        motion=_motion(registers, plan, settings),
    )


def _registers(
    plan: RegisterPlan, sized: RegisterPlan, settings: SinumerikSettings, degC: dict[str, Floats], n: int
) -> list[Register]:
    """Registers of the plan with their way through writer and control; clamps are those of the commissioning sheet."""
    speed_mm_per_s = settings.replay.md32000_mm_per_min / 60.0
    temperature_um_per_s = 1e3 * settings.md32760_comp_add_velo_factor * speed_mm_per_s
    sag_um_per_s = 1e3 * settings.md32730_cec_max_velo_factor * speed_mm_per_s
    clamps = {axis.axis.name: axis for axis in sized.axes}
    out = []
    for axis in plan.axes:
        sizes = clamps[axis.axis.name]
        for wanted, name, law, um_per_unit, clamp in (
            (axis.k0_source, "K0", axis.register_k0_mm, 1e3, sizes.clamp_k0_mm),
            (axis.tan_beta_source, "tanβ", axis.register_tan_beta, 1e3 * axis.longest_arm_mm, sizes.clamp_tan_beta),
        ):
            if wanted:
                stages = _writer(settings, um_per_unit, clamp)
                stages.append(Stage(STEP, partial(rate_limit, rate_per_s=temperature_um_per_s / um_per_unit)))
                out.append(_register(axis.channel_axis, name, law, um_per_unit, stages, degC, n))
    for table in plan.tables:
        um_per_unit = 1e3 * table.largest_mm
        stages = _writer(settings, um_per_unit, 1.0)
        stages.append(Stage(SUM_STEP, partial(rate_limit, rate_per_s=sag_um_per_s / um_per_unit)))
        out.append(_register(table.output.channel_axis, _table_name(table), table.weight, um_per_unit, stages, degC, n))
    return out + _sums(plan, out)


def _sums(plan: RegisterPlan, registers: list[Register]) -> list[Register]:
    """The sum of all sag tables of an output axis in µm, every base axis at its worst position."""
    out = []
    for name, limit_mm in plan.max_sum_mm.items():
        tables = [t for t in plan.tables if t.output.axis.name == name]
        own = [next(r for r in registers if r.name == _table_name(t)) for t in tables]
        total_um = np.sum([np.abs(hold_gaps(r.wanted)) * r.um_per_unit for r in own], axis=0)
        stage = Stage(SUM, partial(clip, limit=1e3 * limit_mm))
        out.append(Register(tables[0].output.channel_axis, "sum of the tables", total_um, 1.0, (stage,)))
    return out


def _table_name(table: SagTable) -> str:
    return f"weight of table {table.index} ({table.source})"


def _writer(settings: SinumerikSettings, um_per_unit: float, clamp: float) -> list[Stage]:
    """What the writer does to a value, in its order."""
    own = settings.replay
    stages = [
        Stage(UPDATE, partial(sample_and_hold, period_s=own.update_s)),
        Stage(CLAMP, partial(clip, limit=clamp)),
    ]
    if own.largest_entry_um is not None:
        stages.append(Stage(ENTRY, partial(clip, limit=own.largest_entry_um / um_per_unit)))
    if own.entry_step_um > 0:
        stages.append(Stage(ROUNDING, partial(quantise, step=own.entry_step_um / um_per_unit)))
    if own.filter_cycles > 1:
        stages.append(Stage(FILTER, partial(moving_average, cycles=own.filter_cycles, cycle_s=own.filter_cycle_s)))
    stages.append(Stage(RAMP, partial(rate_limit, rate_per_s=settings.rate_limit_um_per_s / um_per_unit)))
    return stages


def _register(
    axis: str, name: str, law: RegisterLaw, um_per_unit: float, stages: list[Stage], degC: dict[str, Floats], n: int
) -> Register:
    wanted = np.broadcast_to(law.at(degC), (n,)).astype(np.float64)
    return Register(axis, name, wanted, um_per_unit, tuple(stages))


def _motion(registers: list[Register], plan: RegisterPlan, settings: SinumerikSettings) -> tuple[MotionCheck, ...]:
    """The compensation that changes because the axis moves at full speed, against what the control allows."""
    speed_mm_per_s = settings.replay.md32000_mm_per_min / 60.0
    out = []
    for register in registers:
        table = next((t for t in plan.tables if _table_name(t) == register.name), None)
        own = register.name == "tanβ"
        if not own and table is None:
            continue
        slope = np.nanmax(np.abs(register.wanted)) if np.isfinite(register.wanted).any() else 0.0
        if table is not None:
            slope *= 1e-6 * table.slope_ref_um_per_m
        factor = settings.md32760_comp_add_velo_factor if own else settings.md32730_cec_max_velo_factor
        name = f"{register.name} of {register.axis}"
        out.append(MotionCheck(name, 1e3 * float(slope) * speed_mm_per_s, 1e3 * factor * speed_mm_per_s))
    return tuple(out)
