"""Rigid motions: rotation and translation, no scale. Coordinates in mm, small motions in µm and µrad.

A small motion (6,) is a translation (µm) and a rotation vector (µrad) about a centre: a point at the lever `d` (m) from
the centre moves by `translation + rotation x d` (µm).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thetacomp.arrays import Bools, Floats
from thetacomp.campaign import TrackerSettings

ITERATIONS = 20
# A direction of the tracker is never better than this, so that the weights stay finite below the zenith.
SMALLEST_SD_UM = 0.1
# Points count as one line where they leave it by less than this share of their length.
LINE_SHARE = 0.02
# A point is a gross error where it misses by this many times the median miss: no good point does.
GROSS_ERROR = 8.0


@dataclass(frozen=True)
class Rigid:
    """`rotation` (3, 3) and `translation_mm` (3,): x -> rotation x + translation."""

    rotation: Floats
    translation_mm: Floats

    def apply(self, points_mm: Floats) -> Floats:
        """Points (n, 3) after the motion."""
        return np.asarray(points_mm @ self.rotation.T + self.translation_mm)

    def after(self, motion: Floats, centre_mm: Floats) -> Rigid:
        """This motion followed by a small one (6,) about `centre_mm`."""
        turn = rotation_matrix(motion[3:] * 1e-6)
        shifted = turn @ (self.translation_mm - centre_mm) + centre_mm + motion[:3] * 1e-3
        return Rigid(turn @ self.rotation, shifted)

    def motion_from(self, other: Rigid, centre_mm: Floats) -> Floats:
        """The small motion (6,) about `centre_mm` that leads from `other` to this one."""
        turn = self.rotation @ other.rotation.T
        at_other = other.rotation.T @ (centre_mm - other.translation_mm)
        shift = self.apply(at_other[None, :])[0] - centre_mm
        return np.concatenate([shift * 1e3, rotation_vector(turn) * 1e6])


def rotation_matrix(vector_rad: Floats) -> Floats:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3), by Rodrigues' formula."""
    vector_rad = np.asarray(vector_rad, dtype=float)
    angle = np.linalg.norm(vector_rad, axis=-1)[..., None, None]
    cross = np.zeros((*vector_rad.shape, 3))
    x, y, z = vector_rad[..., 0], vector_rad[..., 1], vector_rad[..., 2]
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -z, y, -x
    cross -= np.swapaxes(cross, -1, -2)
    half = np.sinc(angle / (2 * np.pi))  # sin(a/2) / (a/2): exact near zero too
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half**2 * (cross @ cross))


def rotation_vector(matrix: Floats) -> Floats:
    """Rotation vector (3,) of a rotation by less than half a turn."""
    skew = 0.5 * np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    sine = float(np.linalg.norm(skew))
    angle = float(np.arctan2(sine, 0.5 * (np.trace(matrix) - 1.0)))
    return np.asarray(skew if sine < 1e-12 else skew * (angle / sine))


def design(points_mm: Floats, centre_mm: Floats) -> Floats:
    """How a small motion about `centre_mm` moves points: (n, 3, 6), µm per (µm, µrad)."""
    lever_m = (points_mm - centre_mm) / 1000.0
    out = np.zeros((len(points_mm), 3, 6))
    out[:, 0, 0] = out[:, 1, 1] = out[:, 2, 2] = 1.0
    x, y, z = lever_m.T
    out[:, 0, 4], out[:, 0, 5] = z, -y
    out[:, 1, 3], out[:, 1, 5] = -z, x
    out[:, 2, 3], out[:, 2, 4] = y, -x
    return out


def point_covariance_um2(points_mm: Floats, instrument: TrackerSettings) -> Floats:
    """Covariance (n, 3, 3) of points in the tracker's own frame: the tracker in the origin, its standing axis along z.

    The distance errs along the line of sight, the horizontal angle by `angle * horizontal distance` across it, the
    vertical angle by `angle * distance` upwards.
    """
    distance = np.linalg.norm(points_mm, axis=1)
    level = np.hypot(points_mm[:, 0], points_mm[:, 1])
    sight = points_mm / np.maximum(distance, 1e-9)[:, None]
    azimuth = np.arctan2(points_mm[:, 1], points_mm[:, 0])
    across = np.column_stack([-np.sin(azimuth), np.cos(azimuth), np.zeros(len(points_mm))])
    upwards = np.cross(sight, across)
    sd = np.column_stack(
        [
            instrument.distance_sd_um + instrument.distance_sd_um_per_m * distance / 1000.0,
            instrument.horizontal_sd_urad * level / 1000.0,
            instrument.vertical_sd_urad * distance / 1000.0,
        ]
    )
    axes = np.stack([sight, across, upwards], axis=1)
    return np.asarray(np.einsum("nki,nk,nkj->nij", axes, np.maximum(sd, SMALLEST_SD_UM) ** 2, axes))


def turned(covariance: Floats, rotation: Floats) -> Floats:
    """Covariances (n, 3, 3) in axes turned by `rotation` (3, 3) or (n, 3, 3)."""
    return np.asarray(rotation @ covariance @ np.swapaxes(rotation, -1, -2))


def line_direction(points_mm: Floats) -> Floats | None:
    """Direction (3,) of the line on which all points lie; None where they span a plane. One point: zeros."""
    centred = points_mm - points_mm.mean(axis=0)
    _, spread, directions = np.linalg.svd(centred, full_matrices=False)
    if spread[0] < 1e-6:
        return np.zeros(3)
    return None if len(spread) > 1 and spread[1] > LINE_SHARE * spread[0] else np.asarray(directions[0])


def best_fit(source_mm: Floats, target_mm: Floats) -> Rigid:
    """Unweighted rigid fit (Kabsch 1976): the start of the weighted one."""
    source, target = source_mm.mean(axis=0), target_mm.mean(axis=0)
    u, _, vt = np.linalg.svd((target_mm - target).T @ (source_mm - source))
    turn = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return Rigid(turn, target - turn @ source)


@dataclass(frozen=True)
class RigidFit:
    """A weighted rigid fit: covariance (6, 6) of its small motion about `centre_mm`, residuals (n, 3) in µm.

    `covariance` holds the stated uncertainty of the points alone. `used` is False for points left out as outliers.
    """

    transform: Rigid
    centre_mm: Floats
    covariance: Floats
    residual_um: Floats
    weight: Floats
    used: Bools


def fit_rigid(source_mm: Floats, target_mm: Floats, covariance_um2: Floats) -> RigidFit:
    """Rotation and translation from source to target (n, 3), each point weighted by its covariance (n, 3, 3).

    Weighted least squares by Gauss-Newton from the unweighted fit. Points that miss by more than eight times the
    median are left out.
    """
    transform, centre = best_fit(source_mm, target_mm), target_mm.mean(axis=0)
    used = np.ones(len(source_mm), dtype=bool)
    for _ in range(ITERATIONS):
        weight = np.linalg.inv(turned(covariance_um2, transform.rotation))
        residual = 1000.0 * (transform.apply(source_mm) - target_mm)
        jacobian = design(target_mm, centre)
        kept = weight * used[:, None, None]
        normal = np.einsum("nia,nij,njb->ab", jacobian, kept, jacobian)
        step = np.linalg.solve(normal, -np.einsum("nia,nij,nj->a", jacobian, kept, residual))
        transform = transform.after(step, centre)
        size = np.linalg.norm(1000.0 * (transform.apply(source_mm) - target_mm), axis=1)
        again = size <= max(GROSS_ERROR * float(np.median(size[used])), 1.0)
        settled = float(np.abs(step).max()) < 1e-4
        if settled and np.array_equal(again, used):
            break
        if settled and again.sum() >= max(4, len(used) // 2):
            used = again
    residual = 1000.0 * (transform.apply(source_mm) - target_mm)
    return RigidFit(transform, centre, np.asarray(np.linalg.inv(normal)), residual, np.asarray(kept), used)


def scale_um_per_m(fit: RigidFit, target_mm: Floats) -> tuple[float, float]:
    """How much longer than the target the source is, in µm/m, with its standard error from the scatter of the points.

    One more unknown beside the rigid motion; it is estimated for the report, and never applied.
    """
    lever_m = (target_mm - fit.centre_mm) / 1000.0
    jacobian = np.concatenate([design(target_mm, fit.centre_mm), lever_m[:, :, None]], axis=2)
    normal = np.einsum("nia,nij,njb->ab", jacobian, fit.weight, jacobian)
    inverse = np.linalg.inv(normal)
    solution = inverse @ np.einsum("nia,nij,nj->a", jacobian, fit.weight, fit.residual_um)
    rest = fit.residual_um - jacobian @ solution
    freedom = max(3 * int(fit.used.sum()) - 7, 1)
    variance = max(float(np.einsum("ni,nij,nj->", rest, fit.weight, rest)) / freedom, 1.0)
    return float(solution[6]), float(np.sqrt(variance * inverse[6, 6]))
