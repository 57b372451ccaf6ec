"""From end to end on the virtual machine: measure, fit, compensate with the stored model, verify."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from thetacomp.analysis import analyze_folder
from thetacomp.campaign import Temperatures
from thetacomp.models.document import ModelDocument
from thetacomp.prediction import predict
from thetacomp.reading import Positions, read_folder
from thetacomp.twin.campaigns import Correction, Twin, plan_campaigns, run_campaign
from thetacomp.twin.mesh import Floats
from thetacomp.twin.writer import write_campaign, write_twin
from thetacomp.verification import verify_folder


def from_model(model: ModelDocument, sensors: tuple[str, ...], reference_s: float, sign: float) -> Correction:
    """The drift of each direction from the sweep along Y, once, and the slopes of all axes."""
    p0_mm = {axis.name: float(np.mean(axis.travel_mm)) for axis in model.axes}

    def correction(t_read: Floats, reading: Floats, t_s: Floats, positions: Mapping[str, Floats]) -> Floats:
        table = Temperatures(t_read, sensors, reading)

        def error(axis: str, at_mm: Floats) -> Floats:
            asked = Positions(t_s=t_s, axis=(axis,) * len(t_s), position_mm=at_mm)
            return np.nan_to_num(predict(model, table, asked, reference_s).error_um)

        middle = {name: np.full(len(t_s), p) for name, p in p0_mm.items()}
        total = error("Y", middle["Y"])
        for name in p0_mm:
            total = total + error(name, positions[name]) - error(name, middle[name])
        return np.asarray(-sign * total)

    return correction


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_compensated_virtual_machine_is_verified(twin: Twin, tmp_path: Path) -> None:
    folder = tmp_path / "machine"
    plans = plan_campaigns(twin, 4)
    records = write_twin(folder, twin, plans[:3])
    model = analyze_folder(read_folder(folder)).model
    sensors = tuple(s.id for s in twin.sensors)
    reference_s = records[0].reference_s
    for name, sign in (("right", 1.0), ("wrong", -1.0)):
        record = run_campaign(twin, plans[3], from_model(model, sensors, reference_s, sign))
        write_campaign(folder / "campaigns" / name, twin, record, compensation="on")
    read = read_folder(folder)
    off = [plan.name for plan in plans[:3]]
    right = verify_folder(read, off, ["right"], model)
    wrong = verify_folder(read, off, ["wrong"], model)
    column = {r.component: r.of("rms").like_reduction_percent for r in right.rows}
    assert right.go, right.causes
    # Measured once: 52 and 88 %.
    assert column["column_X"] > 30.0
    assert column["column_Z"] > 70.0
    largest = max((s for s in right.shares if s.part == "all"), key=lambda s: s.size_um)
    assert largest.value == pytest.approx(1.0, abs=0.25)
    assert not wrong.go
    assert [cause.kind for cause in wrong.causes] == ["reversed"]
    assert wrong.causes[0].text.startswith("all ")
