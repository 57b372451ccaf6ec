"""The machine at work: duty to heat, heat to temperatures, with what acts back (oil films, chiller).

Steps are one minute. Powers of bearings depend on the temperature of their oil, the chiller on that of the tank:
both are taken at the start of each step, which is short against every oil's time constant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Floats, Ints
from thetacomp.model.temperatures import Duty
from thetatwin.description import Bearing, Description, Oil, Source
from thetatwin.thermal import AIR_INPUTS, COOLING_INPUT, GROUND_INPUT, air_pattern
from thetatwin.virtual_machine import VirtualMachine

STEP_S = 60.0
SPEED = "spindle_rpm"
_CHUNK = 1440


@dataclass(frozen=True)
class Work:
    """What the machine does, minute by minute (n,): switched on (0, 1), spindle speed, feed of each axis in m/min
    (mean over the minute, already times the share of time it moves), chiller (0, 1)."""

    on: Floats
    rpm: Floats
    feed_m_min: Mapping[str, Floats]
    chiller: Floats


def spindle_duty(work: Work, t_s: Floats, own_s: Floats) -> Duty:
    """Spindle speed at times counted from the first minute of `work`, under the times `own_s` of a table.

    The machine stands still before the first minute.
    """
    rows = np.floor(t_s / STEP_S).astype(np.int64)
    rpm = np.where(rows < 0, 0.0, work.rpm[np.clip(rows, 0, len(work.rpm) - 1)])
    return Duty(own_s, {SPEED: rpm})


def at_minute(by_minute: Floats, t_s: Floats) -> Floats:
    """Values of the minutes in which the times lie."""
    rows: Ints = np.clip(np.floor(t_s / STEP_S).astype(np.int64), 0, len(by_minute) - 1)
    return np.asarray(by_minute[rows])


@dataclass(frozen=True)
class History:
    """Temperatures over time. `t_s` (n + 1,) every minute; `sensors_degC` and `air_degC` (n + 1, sensors) at the
    sensors and in the air around them; `kept_s` and `states` are the modal states kept (every `keep`-th)."""

    t_s: Floats
    sensors_degC: Floats
    air_degC: Floats
    kept_s: Floats
    states: Floats
    end: Floats

    def poses(self, machine: VirtualMachine, t_s: Floats) -> Floats:
        """Tool poses (len(t_s), tool rows) at any times, linear between kept states."""
        rows = machine.reduced.rows[machine.tool_rows]
        k = np.clip(np.searchsorted(self.kept_s, t_s) - 1, 0, len(self.kept_s) - 2)
        share = ((t_s - self.kept_s[k]) / (self.kept_s[k + 1] - self.kept_s[k]))[:, None]
        return np.asarray(((1 - share) * self.states[k] + share * self.states[k + 1]) @ rows.T)


def source_power_W(source: Source, work: Work) -> Floats:
    """Power of a source without its bearing part, (n,)."""
    power = source.on_W * work.on + source.per_rpm_W * work.rpm
    if source.axis is not None:
        feed = work.feed_m_min[source.axis]
        power = power + source.per_m_min_W * feed + source.friction_N * feed / 60.0
        if source.lead_mm is not None:
            # torque times angular speed of the screw
            power = power + source.torque_Nm * 2 * np.pi * feed * 1000.0 / source.lead_mm / 60.0
    return np.asarray(power)


def bearing_moments(bearing: Bearing, rpm: Floats) -> tuple[Floats, Floats]:
    """Power in W as `a ν^(2/3) + b` with ν in mm²/s, (n,) each (Palmgren; Harris and Kotzalas)."""
    omega = rpm * 2 * np.pi / 60.0
    viscous_Nm = 1e-10 * bearing.f0 * rpm ** (2.0 / 3.0) * bearing.mean_diameter_mm**3
    load_Nm = 1e-3 * bearing.f1 * bearing.load_N * bearing.mean_diameter_mm
    return viscous_Nm * omega, load_Nm * omega


def viscosity_mm2_per_s(oil: Oil, temperature_degC: Floats) -> Floats:
    """Kinematic viscosity of the oil."""
    return np.asarray(oil.nu40_mm2_per_s * np.exp(-oil.falloff_per_K * (np.clip(temperature_degC, 5.0, 70.0) - 40.0)))


def known_inputs(
    description: Description, names: tuple[str, ...], work: Work, air_K: Floats, floor_K: Floats
) -> Floats:
    """Inputs (n, inputs) that do not depend on temperature."""
    inputs = np.zeros((len(work.on), len(names)))
    for source in description.sources:
        inputs[:, names.index(source.name)] = source_power_W(source, work)
    for k, name in enumerate(AIR_INPUTS):
        inputs[:, names.index(name)] = air_K[:, k]
    inputs[:, names.index(GROUND_INPUT)] = floor_K
    return inputs


def rest_state(machine: VirtualMachine, air_K: Floats, floor_K: float) -> Floats:
    """Modal state of a machine that has stood in this air for long."""
    inputs = np.zeros(len(machine.reduced.inputs))
    inputs[[machine.reduced.inputs.index(name) for name in AIR_INPUTS]] = air_K
    inputs[machine.reduced.inputs.index(GROUND_INPUT)] = floor_K
    return machine.reduced.steady(inputs)


def simulate(
    machine: VirtualMachine, work: Work, air_K: Floats, floor_K: Floats, start: Floats, keep: int = 1
) -> History:
    """Run the reduced model through n minutes. Modal states are kept every `keep` minutes, sensors every minute."""
    description, model = machine.description, machine.reduced
    names, reference = model.inputs, description.reference_degC
    decay, drive = model.step(STEP_S)
    inputs = known_inputs(description, names, work, air_K, floor_K)
    geared = [s for s in description.sources if s.bearing is not None]
    bearings = [s.bearing for s in geared if s.bearing is not None]
    acting = np.ascontiguousarray(drive[:, [*(names.index(s.name) for s in geared), names.index(COOLING_INPUT)]])
    films = [machine.feedback.index(b.film) for b in bearings]
    oil_row = machine.feedback.index(description.cooling.lump)
    moments = [bearing_moments(b, work.rpm) for b in bearings]
    viscous = np.stack([m[0] for m in moments], axis=1) if moments else np.zeros((len(work.on), 0))
    loaded = np.stack([m[1] for m in moments], axis=1) if moments else np.zeros((len(work.on), 0))
    feedback_rows = np.ascontiguousarray(model.rows[machine.feedback_rows])
    sensor_rows = model.rows[machine.sensor_rows]
    cooling, n, state = description.cooling, len(work.on), start
    sensors = np.empty((n + 1, len(sensor_rows)))
    sensors[0] = sensor_rows @ state
    kept = [state[None]]
    power = np.zeros(acting.shape[1])
    for begin in range(0, n, _CHUNK):
        forced = inputs[begin : begin + _CHUNK] @ drive.T
        states = np.empty_like(forced)
        for k in range(len(forced)):
            warm = feedback_rows @ state + reference
            if work.rpm[begin + k] > 0:
                nu = viscosity_mm2_per_s(description.oil, warm[films])
                power[:-1] = viscous[begin + k] * nu ** (2.0 / 3.0) + loaded[begin + k]
            else:
                power[:-1] = 0.0
            surplus = cooling.conductance_W_per_K * (warm[oil_row] - cooling.setpoint_degC)
            power[-1] = work.chiller[begin + k] * min(max(surplus, 0.0), cooling.limit_W)
            state = decay * state + forced[k] + acting @ power
            states[k] = state
        sensors[begin + 1 : begin + 1 + len(states)] = states @ sensor_rows.T
        kept.append(states[(keep - 1 - begin) % keep :: keep])
    return _history(machine, sensors, air_K, np.concatenate(kept), keep, state)


def _history(
    machine: VirtualMachine, sensors: Floats, air_K: Floats, states: Floats, keep: int, end: Floats
) -> History:
    reference = machine.description.reference_degC
    places = np.array([s.at_mm for s in machine.description.sensors]) * 1e-3
    air = np.concatenate([air_K[:1], air_K]) @ air_pattern(machine.description.air, places).T + reference
    t_s = STEP_S * np.arange(float(len(sensors)))
    return History(t_s, sensors + reference, air, t_s[::keep][: len(states)], states, end)
