"""Heat conduction against a series solution, and the balance of energy of the whole machine."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.optimize import brentq
from scipy.sparse.linalg import spsolve

from thetatwin.description import Block, Body, Material
from thetatwin.elastic import scalar_spaces
from thetatwin.mesh import face_weights, mesh_body
from thetatwin.thermal import AIR_INPUTS, GROUND_INPUT, ThermalSystem, body_matrices, transient
from thetatwin.virtual_machine import VirtualMachine


def test_a_slab_that_cools_at_one_face_follows_the_series(iron: Material) -> None:
    thickness, film = 0.4, 400.0  # m, W/(m² K)
    body = Body(
        name="slab",
        material="iron",
        element_mm=10.0,
        to_air_W_per_m2_K=0.0,
        to_cavity_W_per_m2_K=0.0,
        blocks=(Block(from_mm=(0, 0, 0), to_mm=(400, 10, 10)),),
    )
    mesh = mesh_body(body)
    capacity, conduction = body_matrices(iron, scalar_spaces(mesh))
    face = face_weights(mesh, np.array([0.4, 0, 0]), np.array([0.4, 0.01, 0.01]), "+X")
    n = len(mesh.points_m)
    cooled = np.zeros(n)
    cooled[face.nodes] = film * face.weight_m2
    system = ThermalSystem(
        capacity, conduction + sp.diags_array(cooled).tocsc(), np.zeros((n, 1)), ("none",), {"slab": 0}, {"slab": n}
    )
    spots = [int(np.argmin(np.abs(mesh.points_m[:, 0] - x))) for x in (0.0, 0.2, 0.4)]
    rows = np.zeros((3, n))
    rows[[0, 1, 2], spots] = 1.0
    out = transient(system, np.zeros((240, 1)), 60.0, rows, start=np.ones(n))
    # Carslaw and Jaeger, Conduction of Heat in Solids, 3.10: T = Σ C cos(ζ x / L) exp(-ζ² Fo), ζ tan ζ = Bi
    biot = film * thickness / iron.conductivity_W_per_m_K
    diffusivity = iron.conductivity_W_per_m_K / (iron.density_kg_per_m3 * iron.specific_heat_J_per_kg_K)
    zeta = np.array(
        [brentq(lambda z: z * np.sin(z) - biot * np.cos(z), k * np.pi + 1e-9, (k + 0.5) * np.pi) for k in range(30)]
    )
    share = 4 * np.sin(zeta) / (2 * zeta + np.sin(2 * zeta))
    for step in (20, 60, 240):
        fourier = diffusivity * step * 60.0 / thickness**2
        exact = [
            float(np.sum(share * np.cos(zeta * x / thickness) * np.exp(-(zeta**2) * fourier))) for x in (0, 0.2, 0.4)
        ]
        assert out[step] == pytest.approx(exact, abs=5e-4)


def inputs(machine: VirtualMachine, **values: float) -> np.ndarray:
    out = np.zeros(len(machine.system.inputs))
    for name, value in values.items():
        out[machine.system.inputs.index(name)] = value
    return out


def test_in_still_air_of_one_temperature_the_whole_machine_takes_it(coarse: VirtualMachine) -> None:
    warm = inputs(coarse, air_K=3.0, ground_K=3.0)
    rise = spsolve(coarse.system.conductance, coarse.system.source @ warm)
    assert rise == pytest.approx(3.0, abs=1e-8)


def test_energy_balance(coarse: VirtualMachine) -> None:
    """What the sources give either warms the machine or leaves to air and ground, watt for watt."""
    system = coarse.system
    power = np.zeros(len(system.inputs))
    sources = [system.inputs.index(s.name) for s in coarse.description.sources]
    power[sources] = np.random.default_rng(3).uniform(50, 800, len(sources))
    shares = np.array([sum(s.shares.values()) for s in coarse.description.sources])
    entering_W = float(power[sources] @ shares)
    # Sum of all temperatures weighted by their capacity: heat stored. Loss: temperatures times film conductances.
    films = system.source[:, system.inputs.index(AIR_INPUTS[0])] + system.source[:, system.inputs.index(GROUND_INPUT)]
    rows = np.stack([np.asarray(system.capacity.sum(axis=0)).ravel(), films])
    step_s, steps = 60.0, 600
    stored, lost = transient(system, np.tile(power, (steps, 1)), step_s, rows).T
    lost_J = float(np.sum(0.5 * (lost[1:] + lost[:-1])) * step_s)
    assert stored[-1] + lost_J == pytest.approx(entering_W * step_s * steps, rel=1e-4)
    steady = spsolve(system.conductance, system.source @ power)
    assert films @ steady == pytest.approx(entering_W, rel=1e-9)


def test_reciprocity_of_heat(coarse: VirtualMachine) -> None:
    """A watt at one place warms another as much as a watt there warms the first."""
    system = coarse.system
    nut, oil = system.offset["w_nut"], system.offset["oil"]
    watt = np.zeros((system.states, 2))
    watt[[nut, oil], [0, 1]] = 1.0
    rise = spsolve(system.conductance, watt)
    assert rise[oil, 0] == pytest.approx(rise[nut, 1], rel=1e-9)
    assert rise[oil, 0] > 1e-5


def test_a_draught_cools_the_column_side_of_the_door_most(coarse: VirtualMachine) -> None:
    rise = coarse.reduced.rows @ coarse.reduced.steady(inputs(coarse, draught_K=1.0))
    readings = dict(zip((s.id for s in coarse.description.sensors), rise[coarse.sensor_rows], strict=True))
    assert readings["theta_14"] < readings["theta_1"] < 0.0
