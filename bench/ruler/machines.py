"""The machines that the ruler measures: their folders, and the predictions that are asked for each of them."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ruler.program import Floats, Request, command

Series = Mapping[str, Floats]  # `t_s` and other columns of one length
HERE = Path(__file__).parent
ROOT = HERE.parents[1]
EXAMPLES = {"spindle": ROOT / "examples" / "spindle", "tk6920": ROOT / "src" / "thetacomp" / "examples" / "tk6920"}
RECORDING = Path("caiviac_fl_thermal") / "data.xlsx"  # below the folder of shared data, as the tests have it
# name: preset and seed of the two virtual machines. The second loses where the other axes stood: separate form.
VIRTUAL = {"joint": ("standard.toml", 1), "separate": ("hard.toml", 3)}
CAMPAIGNS = 3
LOST = {"joint": "theta_8", "separate": "theta_2", "spindle": "t3"}  # a key sensor of each, left out of a table
TRAVEL_mm = {"X": (0.0, 4000.0), "Y": (0.0, 3000.0), "W": (0.0, 1000.0)}
WORKPIECE = {"wanted": "workpiece", "workpiece_expansion_per_K": 11.5e-6}
SPINDLE_STARTS = (1951, 9631)  # first rows of two campaigns of the recording
SPINDLE_ROWS = 1400


def make_virtual(name: str, work: Path) -> Path:
    """Generate a virtual machine with the program under test; its folder."""
    preset, seed = VIRTUAL[name]
    shutil.copy(HERE / preset, work / preset)
    command(
        work, "twin", "--out", f"made-{name}", "--preset", preset, "--seed", str(seed), "--campaigns", str(CAMPAIGNS)
    )
    return work / f"made-{name}"


def without_places(folder: Path) -> None:
    """Take out of all campaigns where the other axes stood: what is left can only be separated axis by axis."""
    for name in ("sweeps.csv", "drift.csv"):
        for path in folder.glob(f"campaigns/*/{name}"):
            head, *rows = _read(path)
            kept = [k for k, column in enumerate(head) if not column.startswith("at_")]
            _write(path, ([row[k] for k in kept] for row in (head, *rows)))


def with_angles(folder: Path) -> None:
    """Give all sweeps and drift readings measured angles, which the virtual tracker has not: turns that grow with time
    and along the axis, and scatter like the displacements."""
    for name in ("sweeps.csv", "drift.csv"):
        for path in folder.glob(f"campaigns/*/{name}"):
            head, *rows = _read(path)
            cells = [dict(zip(head, row, strict=True)) for row in rows]
            for row, cell in zip(rows, cells, strict=True):
                hours, place_m = float(cell["t_s"]) / 3600.0, float(cell.get("position_mm") or 0.0) / 1000.0
                for turn, column in ((3.0, "dX_um"), (-2.0, "dY_um"), (1.0, "dZ_um")):
                    row.append(f"{turn * hours * (0.5 + place_m) + 0.02 * float(cell[column]):.2f}")
            _write(path, ([*head, "rA_urad", "rB_urad", "rC_urad"], *rows))


def add_compensated(folder: Path, campaign: str, share: float = 0.3) -> None:
    """Add a campaign `on`: a copy of another with only a share of its errors, told to be compensated."""
    target = folder / "campaigns" / "on"
    shutil.copytree(folder / "campaigns" / campaign, target)
    for name in ("sweeps.csv", "drift.csv"):
        head, *rows = _read(target / name)
        errors = [k for k, column in enumerate(head) if column in ("dX_um", "dY_um", "dZ_um")]
        for row in rows:
            for k in errors:
                row[k] = f"{share * float(row[k]):.2f}" if row[k] else ""
        _write(target / name, (head, *rows))
    settings = target / "campaign.toml"
    text = settings.read_text(encoding="utf-8")
    settings.write_text(text.replace('compensation = "off"', 'compensation = "on"'), encoding="utf-8")


def campaigns_of(folder: Path) -> list[str]:
    """Names of the campaigns of a machine folder, in order."""
    return sorted(path.name for path in (folder / "campaigns").iterdir())


# --- what is asked of the models ---


def tk6920_requests(folder: Path) -> list[Request]:
    """Each axis with the temperatures of its own campaign: the example has one sensor an axis."""
    requests = []
    for axis, (low, high) in TRAVEL_mm.items():
        temperatures = _series(folder / "campaigns" / axis / "temperatures.csv")
        temperatures["t_s"] = 3600.0 * temperatures.pop("t_h")
        for reference in ("first_row", "model"):
            one = _axis_rows(f"{axis} {reference}", temperatures, None, reference, {axis: (low, high)}, 40)
            requests.append(one)
    return requests


def spindle_requests(data: Path) -> list[Request]:
    """Drift from two stretches of the recording, with a sensor missing, and with all rises doubled."""
    raw = pd.read_excel(data, engine="calamine").to_numpy(dtype=np.float64)
    requests = []
    for start, reference in zip(SPINDLE_STARTS, ("first_row", "model"), strict=True):
        part = raw[start : start + SPINDLE_ROWS]
        temperatures = {"t_s": part[:, 0] - part[0, 0], **{f"t{k}": part[:, 6 + k] for k in range(1, 17)}}
        duty = {"t_s": temperatures["t_s"], "spindle_rpm": part[:, 1]}
        requests.append(_axis_rows(reference, temperatures, duty, reference, {}, 300))
    one = requests[0]
    lost = {name: values for name, values in one.temperatures.items() if name != LOST["spindle"]}
    requests.append(_axis_rows("sensor missing", lost, one.duty, "first_row", {}, 200))
    requests.append(_axis_rows("beyond", _doubled(one.temperatures), one.duty, "first_row", {}, 200))
    return requests


def virtual_requests(name: str, folder: Path, volume: bool) -> list[Request]:
    """Rows of all axes and of drift, and with `volume` positions of all axes: ordinary, reference of the model, one
    sensor missing, and all rises doubled."""
    campaigns = [folder / "campaigns" / campaign for campaign in campaigns_of(folder)]
    tables = [_series(campaign / "temperatures.csv") for campaign in campaigns]
    duties = [_series(campaign / "duty.csv") for campaign in campaigns]
    lost = {sensor: values for sensor, values in tables[0].items() if sensor != LOST[name]}
    asked = (
        ("first_row", tables[0], duties[0], "first_row"),
        ("model", tables[2], duties[2], "model"),
        ("sensor missing", lost, duties[0], "first_row"),
        ("beyond", _doubled(tables[1]), duties[1], "first_row"),
    )
    requests = [_axis_rows(*one, TRAVEL_mm, 20) for one in asked]
    if volume:
        requests += [_volume_rows(f"volume {one[0]}", *one[1:], 160) for one in asked]
    return requests


def _axis_rows(
    name: str,
    temperatures: Series,
    duty: Series | None,
    reference: str,
    travel_mm: Mapping[str, tuple[float, float]],
    moments: int,
) -> Request:
    """`moments` moments over the table; at each of them four positions of every axis (one of them outside of the
    travel), and drift."""
    t_s = _moments(temperatures, moments)
    places = [("", np.nan)]
    for axis, (low, high) in travel_mm.items():
        places += [(axis, low + share * (high - low)) for share in (0.0, 0.37, 0.81, 1.15)]
    if len(travel_mm) == 1:
        places = places[1:]
    return Request(
        name=name,
        temperatures=temperatures,
        duty=duty,
        reference=reference,
        t_s=np.repeat(t_s, len(places)),
        axis=tuple(axis for axis, _ in places) * moments,
        position_mm=np.tile([position for _, position in places], moments),
    )


def _volume_rows(name: str, temperatures: Series, duty: Series | None, reference: str, count: int) -> Request:
    """Positions spread over the volume by steps that share no common measure; the tool 150 mm, as measured."""
    k = np.arange(count)
    at_mm = {
        axis: low + (high - low) * np.mod(k * step, 1.0)
        for (axis, (low, high)), step in zip(TRAVEL_mm.items(), np.sqrt([2.0, 3.0, 5.0]), strict=True)
    }
    return Request(
        name=name,
        temperatures=temperatures,
        duty=duty,
        reference=reference,
        t_s=_moments(temperatures, count),
        at_mm=at_mm,
        tool_length_mm=np.where(k % 2 == 0, 150.0, 150.0 + k),
    )


def write_request(request: Request, folder: Path) -> list[str | Path]:
    """Write a request as the tables that `thetacomp predict` reads; the options that name them."""
    folder.mkdir(parents=True, exist_ok=True)
    rows: dict[str, Iterable[object]] = {"t_s": request.t_s}
    if request.at_mm:
        rows |= {f"{axis}_mm": values for axis, values in request.at_mm.items()}
        if request.tool_length_mm is not None:
            rows["tool_length_mm"] = request.tool_length_mm
    else:
        rows |= {"axis": request.axis, "position_mm": request.position_mm}
    tables: dict[str, Mapping[str, Iterable[object]]] = {"temperatures": request.temperatures, "positions": rows}
    if request.duty is not None:
        tables["duty"] = request.duty
    options: list[str | Path] = ["--reference", request.reference]
    for name, columns in tables.items():
        path = folder / f"{name}.csv"
        cells = ([_cell(value) for value in row] for row in zip(*columns.values(), strict=True))
        _write(path, [list(columns), *cells])
        options += [f"--{name}", path]
    return options


def variants(model: Path, folder: Path) -> dict[str, Path]:
    """Copies of a stored model of format 1, to reach what the model in use leaves aside, by name: the law on key
    temperatures (without heat history), and that law without angles, where lengths follow a workpiece."""
    document = json.loads(model.read_text(encoding="utf-8"))
    document["history"] = {}
    sensors = sorted(document["training"]["range_degC"])
    plain = {**document, "rotations": {}, "length": {**document["length"], **WORKPIECE, "workpiece_sensor": sensors[0]}}
    copies = {}
    for name, one in (("law on key temperatures", document), ("length of the workpiece", plain)):
        copies[name] = folder / f"{model.stem} {name}.json"
        copies[name].write_text(json.dumps(one, ensure_ascii=False), encoding="utf-8")
    return copies


def slim_copy(model: Path, copy: Path, lost: str) -> Path:
    """A stored model of format 1; of the large fallbacks of its heat history only those for one sensor."""
    document = json.loads(model.read_text(encoding="utf-8"))
    for axis in document["history"].values():
        axis["fallbacks"] = [fallback for fallback in axis["fallbacks"] if fallback["lost"] == lost]
    copy.write_text(json.dumps(document, ensure_ascii=False), encoding="utf-8")
    return copy


def _moments(temperatures: Series, count: int) -> Floats:
    clock = temperatures["t_s"]
    return np.linspace(clock[0], clock[-1], count)


def _doubled(temperatures: Series) -> dict[str, Floats]:
    """Temperatures whose rise since the first row is twice as large: far outside of any training."""
    out = {}
    for name, values in temperatures.items():
        start = values[np.isfinite(values)][0]
        out[name] = values if name == "t_s" else start + 2.0 * (values - start)
    return out


def _cell(value: object) -> str:
    if isinstance(value, str):
        return value
    number = float(value)  # type: ignore[arg-type]
    return repr(number) if np.isfinite(number) else ""


def _series(path: Path) -> dict[str, Floats]:
    """Columns of a CSV file of numbers; an empty cell is NaN."""
    head, *rows = _read(path)
    return {name: np.array([float(row[k] or "nan") for row in rows]) for k, name in enumerate(head)}


def _read(path: Path) -> list[list[str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def _write(path: Path, rows: Iterable[Sequence[str]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)
