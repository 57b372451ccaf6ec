"""What an analysis says about frame, scale and stations."""

from __future__ import annotations

from collections.abc import Sequence

from thetacomp.campaign import TrackerTie
from thetacomp.tracker.doubt import TrackerDoubt

SCALE_REPORTED_UM_PER_M = 10.0


def describe(tie: TrackerTie, axes: Sequence[str], left_out: int) -> tuple[str, ...]:
    """Frame, scale, and one line a station."""
    gross = f"; {left_out} gross errors left out" if left_out else ""
    notes = [
        f"the machine frame was fitted once, on {tie.cold_points} points of the cold block (axes {', '.join(axes)}),"
        f" without scale: residual RMS {tie.frame_rms_um:.1f} µm, largest {tie.frame_largest_um:.1f} µm{gross}",
        f"scale on the cold block {tie.scale_um_per_m:+.1f} ± {tie.scale_se_um_per_m:.1f} µm/m (standard error),"
        " measured against commanded: reported, not applied; it stays in the geometry",
    ]
    for item in tie.closures:
        moved = ", ".join(f"{value:+.0f} ± {se:.0f}" for value, se in zip(item.moved_um, item.moved_se_um, strict=True))
        motion = (
            f"the tracker moved by {moved} µm (machine X, Y, Z, standard error) from the first round to the last;"
            " this was removed"
            if item.rounds > 1
            else "one round only: a motion during the sweeps of this station is not noticed"
        )
        wider = f"; {item.excess:.1f} times the stated uncertainty, the intervals include it" if item.excess > 1 else ""
        notes.append(
            f"station {item.station}: {item.rounds} rounds of {item.targets} foundation targets, closure RMS"
            f" {item.rms_um:.1f} µm, largest {item.largest_um:.1f} µm ({item.largest_target} at"
            f" {item.largest_t_s / 3600:.2f} h){wider}; {motion}"
        )
    if not tie.closures:
        notes.append(
            "no foundation targets were measured: motion of the tracker cannot be separated from drift of the machine"
        )
    return tuple(notes)


def scale_doubt(scale_um_per_m: float, se_um_per_m: float) -> tuple[TrackerDoubt, ...]:
    """A scale that chance does not explain: the laser, or a machine that is compensated to another temperature."""
    if abs(scale_um_per_m) < max(3.0 * se_um_per_m, SCALE_REPORTED_UM_PER_M):
        return ()
    return (
        TrackerDoubt(
            "tracker-scale",
            f"the cold machine measures {scale_um_per_m:+.1f} ± {se_um_per_m:.1f} µm/m (standard error) longer than"
            " commanded. This is not applied: it stays in the geometry.",
            "check air temperature, pressure and humidity in the tracker, and at which temperature the machine is"
            " compensated; 10 µm/m are about 10 K of air or 1 K of steel.",
        ),
    )
