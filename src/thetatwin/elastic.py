"""Linear thermo-elasticity of one body with scikit-fem: stiffness, thermal load, and displacement outputs.

Twenty-node bricks carry the displacement, because eight-node bricks one element thick are too stiff in bending;
the temperature stays linear in each brick.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import SuperLU, splu
from skfem import Basis, BilinearForm, ElementHex1, ElementHexS2, FacetBasis, MeshHex

from thetacomp.arrays import Floats, Ints
from thetatwin.description import Material, Patch
from thetatwin.mesh import AXES, BodyMesh


@dataclass(frozen=True)
class Scalar:
    """Scalar finite-element spaces of one body. `vertex` (nodes,) is the brick dof that sits on each mesh node."""

    linear: Basis
    quadratic: Basis
    vertex: Ints


def scalar_spaces(mesh: BodyMesh) -> Scalar:
    """The linear space for temperatures and the quadratic one for each displacement direction."""
    ordered = _skfem_order(mesh)
    fem = MeshHex(mesh.points_m.T.copy(), ordered.T.copy())
    # Serendipity bricks of box shape are integrated exactly enough by 3 points a direction.
    linear = Basis(fem, ElementHex1(), intorder=4)
    quadratic = Basis(fem, ElementHexS2(), intorder=4)
    return Scalar(linear, quadratic, np.asarray(quadratic.nodal_dofs[0], dtype=np.int64))


def _skfem_order(mesh: BodyMesh) -> Ints:
    reference = MeshHex().p.T  # (8, 3) corners of the unit brick in scikit-fem's order
    own = {(x, y, z): x + 2 * y + 4 * z for x in (0, 1) for y in (0, 1) for z in (0, 1)}
    order = [own[(int(p[0]), int(p[1]), int(p[2]))] for p in reference[MeshHex().t[:, 0]]]
    return np.asarray(mesh.cells[:, order])


def _gradient_form(a: int, b: int) -> BilinearForm:
    def integrand(u: Any, v: Any, _: Any) -> Any:
        return u.grad[b] * v.grad[a]

    return BilinearForm(integrand)


def _load_form(a: int) -> BilinearForm:
    def integrand(temperature: Any, v: Any, _: Any) -> Any:
        return temperature * v.grad[a]

    return BilinearForm(integrand)


@dataclass(frozen=True)
class ElasticBody:
    """One body ready to be solved. Dofs are ordered direction by direction: all X, then all Y, then all Z.

    `stiffness` is free of supports; `load` (dofs, nodes) turns nodal temperature differences (K) into forces (N).
    """

    mesh: BodyMesh
    spaces: Scalar
    stiffness: sp.csc_matrix
    load: sp.csr_matrix

    @property
    def dofs_per_direction(self) -> int:
        """Displacement dofs in each of X, Y, Z."""
        return int(self.spaces.quadratic.N)

    def vertex_dofs(self, direction: int) -> Ints:
        """The dof of every mesh node in one direction."""
        return np.asarray(self.spaces.vertex + direction * self.dofs_per_direction)


def assemble(mesh: BodyMesh, material: Material, spaces: Scalar | None = None) -> ElasticBody:
    """Stiffness as six scalar forms: ∫ C:ε:ε in the Lamé form, and the thermal load ∫ (3λ + 2μ) α T div v."""
    spaces = spaces or scalar_spaces(mesh)
    young = material.young_GPa * 1e9
    lame = young * material.poisson / ((1 + material.poisson) * (1 - 2 * material.poisson))
    shear = young / (2 * (1 + material.poisson))
    part = {(a, b): _gradient_form(a, b).assemble(spaces.quadratic) for a in range(3) for b in range(a, 3)}
    laplace = part[0, 0] + part[1, 1] + part[2, 2]
    rows: list[list[Any]] = []
    for a in range(3):
        row = []
        for b in range(3):
            d_ab = part[a, b] if a <= b else part[b, a].T
            block = lame * d_ab + shear * d_ab.T
            row.append(block + shear * laplace if a == b else block)
        rows.append(row)
    bulk = (3 * lame + 2 * shear) * material.expansion_per_K
    load = sp.vstack([bulk * _load_form(a).assemble(spaces.linear, spaces.quadratic) for a in range(3)])
    return ElasticBody(mesh, spaces, sp.csc_matrix(sp.bmat(rows)), sp.csr_matrix(load))


@dataclass(frozen=True)
class Supported:
    """A body with supports and its factor; `free` are the dofs that may move."""

    body: ElasticBody
    free: Ints
    factor: SuperLU

    def displacement(self, rise_K: Floats) -> Floats:
        """Displacement of every mesh node in m, (nodes, 3), for nodal temperatures above the reference."""
        moved = self.under_force(self.body.load @ rise_K)
        return np.stack([moved[self.body.vertex_dofs(a)] for a in range(3)], axis=1)

    def outputs(self, functionals: sp.csr_matrix) -> Floats:
        """Turn displacement functionals (outputs, dofs) into temperature functionals (outputs, nodes).

        By reciprocity one solve an output is enough: q = c K⁻¹ F T = (K⁻¹ cᵀ)ᵀ F T.
        """
        forces = np.asarray(functionals.todense()).T
        return np.asarray((self.body.load.T @ self.under_force(forces)).T)

    def under_force(self, force: Floats) -> Floats:
        """Displacement of every dof in m, (dofs,) or (dofs, cases), under nodal forces in N."""
        out = np.zeros(force.shape)
        out[self.free] = self.factor.solve(np.ascontiguousarray(force[self.free]))
        return out


def support_statically(body: ElasticBody) -> Supported:
    """Hold six dofs at three far corners, which takes rigid motion away and leaves heat free to deform the body."""
    p = body.mesh.points_m
    lo, hi = p.min(axis=0), p.max(axis=0)
    first = int(np.argmin(np.linalg.norm(p - lo, axis=1)))
    second = int(np.argmin(np.linalg.norm(p - np.array([lo[0], hi[1], lo[2]]), axis=1)))
    third = int(np.argmin(np.linalg.norm(p - np.array([lo[0], lo[1], hi[2]]), axis=1)))
    dof = [body.vertex_dofs(a) for a in range(3)]
    held = [dof[0][first], dof[1][first], dof[2][first], dof[0][second], dof[2][second], dof[0][third]]
    free = np.setdiff1d(np.arange(body.stiffness.shape[0]), held)
    return Supported(body, free, _factor(body.stiffness[free][:, free]))


def support_on_springs(
    body: ElasticBody, pads: Sequence[Patch], stiffness_N_per_m3: float, shear_N_per_m3: float
) -> Supported:
    """Stand the body on a bed of springs (mounts on a foundation): one stiffness along the pads' normal, one across.

    A face of an element rests on the springs where its middle lies in a pad.
    """
    springs: list[Any] = [0.0, 0.0, 0.0]
    fem = body.spaces.quadratic.mesh
    outside = fem.boundary_facets()
    middle = fem.p[:, fem.facets[:, outside]].mean(axis=1).T
    flat = np.ptp(fem.p[:, fem.facets[:, outside]], axis=1).T < 1e-9
    for pad in pads:
        lo, hi = np.array(pad.from_mm) * 1e-3 - 1e-6, np.array(pad.to_mm) * 1e-3 + 1e-6
        normal = AXES.index(pad.normal[1])
        resting = outside[np.all((middle >= lo) & (middle <= hi), axis=1) & flat[:, normal]]
        faces = FacetBasis(fem, ElementHexS2(), facets=resting, intorder=4)
        mass = BilinearForm(lambda u, v, _: u * v).assemble(faces)
        for a in range(3):
            springs[a] = springs[a] + (stiffness_N_per_m3 if a == normal else shear_N_per_m3) * mass
    everything = np.arange(body.stiffness.shape[0])
    return Supported(body, everything, _factor(body.stiffness + sp.block_diag(springs)))


def _factor(matrix: sp.spmatrix) -> SuperLU:
    # Symmetric ordering and no pivoting: the matrix is positive definite, and this is 3 times faster than the default.
    return splu(
        sp.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
