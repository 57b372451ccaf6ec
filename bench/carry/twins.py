"""The virtual machines of the ruler: ordinary and hard ones, with other seeds, duties and mountings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from thetatwin.campaigns import make_twin, plan_campaigns, run_campaign
from thetatwin.conditions import Conditions, load_conditions
from thetatwin.description import Description, TwinSensor, load_description
from thetatwin.mesh import mesh_body, nearest_surface_node
from thetatwin.sensor_sets import with_sensors
from thetatwin.virtual_machine import VirtualMachine, build
from thetatwin.writer import write_machine_folder

OWN = 0  # the mounting of the description


@dataclass(frozen=True)
class TwinPlan:
    """One virtual machine: preset, seed, what its conditions change, and the number of its mounting."""

    preset: str
    seed: int
    mounting: int = OWN
    work: Mapping[str, Any] = field(default_factory=dict)
    pt100: Mapping[str, Any] = field(default_factory=dict)

    def conditions(self) -> Conditions:
        """The preset with its changes."""
        base = load_conditions(self.preset)
        changed = {
            "work": base.work.model_copy(update=self.work),
            "pt100": base.pt100.model_copy(update=self.pt100),
        }
        return base.model_copy(update=changed)


TWINS = {  # in the order of their mountings
    "twin 1": TwinPlan("standard", 311),
    "twin 2": TwinPlan("standard", 312, work={"rpm_max": 1800.0, "warm_h": 5.0, "cool_h": 2.0}),
    "twin 3": TwinPlan("standard", 313, work={"chiller": 0.5, "spacing_days": 28.0}),
    "hard twin 1": TwinPlan("hard", 321),
    "hard twin 2": TwinPlan("hard", 322, work={"rpm_max": 1800.0, "warm_h": 5.0, "cool_h": 2.0}),
    "hard twin 3": TwinPlan("hard", 323, work={"feed_m_min_max": 6.0, "lead_h": 12.0}),
    "twin 4": TwinPlan("standard", 314, mounting=1, work={"spacing_days": 30.0, "between_sweeps_min": 45.0}),
    "hard twin 4": TwinPlan("hard", 324, mounting=1),
    "twin 5": TwinPlan("standard", 315, mounting=2, pt100={"noise_K": 0.1, "lag_s": (60.0, 300.0)}),
    "hard twin 5": TwinPlan("hard", 325, mounting=2, work={"chiller_change": False}),
}


def make_folder(plan: TwinPlan, folder: Path, campaigns: int) -> None:
    """Run the campaigns and write what was measured."""
    twin = make_twin(_built(plan.conditions().machine, plan.mounting), plan.conditions(), plan.seed)
    write_machine_folder(folder, twin, [run_campaign(twin, one) for one in plan_campaigns(twin, campaigns)])


@lru_cache(maxsize=1)
def _built(name: str, mounting: int) -> VirtualMachine:
    """A machine is built once for plans in a row that mount their sensors alike; one takes more than a GB."""
    description = load_description(name)
    return build(description if mounting == OWN else with_sensors(description, _drawn(description, mounting)))


def _drawn(description: Description, mounting: int) -> list[TwinSensor]:
    """Some thermometers on parts, as the description has them, and some on the surface of castings, anywhere."""
    rng = np.random.default_rng([77, mounting])
    on_parts = [s for s in description.sensors if s.place in {lump.name for lump in description.lumps}]
    kept = sorted(rng.choice(len(on_parts), 4, replace=False))
    sensors = [on_parts[k] for k in kept]
    for number in range(8):
        body = description.bodies[int(rng.integers(len(description.bodies)))]
        mesh = mesh_body(body, 1.0)
        span = mesh.points_m.min(axis=0), mesh.points_m.max(axis=0)
        node, _ = nearest_surface_node(mesh, 1e3 * rng.uniform(*span))
        at = tuple(float(v) for v in mesh.points_m[node] * 1e3)
        sensors.append(TwinSensor(id=f"on_{number + 1}", location="", role="structure", place=body.name, at_mm=at))
    return sensors
