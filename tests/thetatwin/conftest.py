"""One coarse virtual machine for all tests here: elements about three times the presets', built in some seconds."""

from __future__ import annotations

import pytest

from thetatwin.campaigns import Twin, make_twin
from thetatwin.conditions import Conditions, load_conditions
from thetatwin.description import Material, load_description
from thetatwin.virtual_machine import VirtualMachine, build


@pytest.fixture(scope="session")
def coarse() -> VirtualMachine:
    return build(load_description("tk6920"), refinement=0.4)


@pytest.fixture(scope="session")
def standard() -> Conditions:
    return load_conditions("standard")


@pytest.fixture(scope="session")
def twin(coarse: VirtualMachine, standard: Conditions) -> Twin:
    return make_twin(coarse, standard, seed=5)


@pytest.fixture(scope="session")
def iron() -> Material:
    return Material(
        young_GPa=120.0,
        poisson=0.26,
        expansion_per_K=11e-6,
        conductivity_W_per_m_K=47.0,
        density_kg_per_m3=7250.0,
        specific_heat_J_per_kg_K=460.0,
        source="round figures of grey cast iron",
    )
