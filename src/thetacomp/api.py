"""The toolkit from Python: tables in memory or files in, models, predictions and files out. See docs/from_python.md.

`import thetacomp` offers these names lazily. Every object has a short repr; `result`, `document` and `prediction` hold
everything that the toolkit itself works with.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from thetacomp import analysis as spine
from thetacomp.analysis_result import AnalysisResult
from thetacomp.arrays import CARTESIAN, Bools, Floats
from thetacomp.campaign import MachineFolder
from thetacomp.controllers.targets import TARGETS
from thetacomp.errors import AnalysisError
from thetacomp.extras import require
from thetacomp.files import Files, write_files
from thetacomp.model.document import ModelDocument
from thetacomp.model.load import load_model as load_stored
from thetacomp.model.prediction import Prediction, Reference, predict
from thetacomp.model.temperatures import Duty, Temperatures
from thetacomp.model.volumetric import VolumePrediction, predict_volume
from thetacomp.outputs import output_folder
from thetacomp.reading import Positions, read_duty, read_folder, read_frames, read_positions, read_temperatures
from thetacomp.reading.single_tables import SingleTable
from thetacomp.verification import verify_folder
from thetacomp.verification.outcome import VerificationResult

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "Analysis",
    "Model",
    "PredictedError",
    "Verification",
    "analyze",
    "export",
    "load_model",
    "read_folder",
    "read_frames",
    "verify",
]

Progress = Callable[[str], None]


@dataclass(frozen=True, repr=False)
class PredictedError:
    """The predicted error `E = actual - commanded` of n rows; `prediction` also says why rows lie outside.

    `error_um`, `lower_um` and `upper_um` (95 %) are (n, 3) along machine X, Y, Z, NaN where there is no value;
    `in_domain` (n,) says whether the row lies inside what the model was trained on.
    """

    prediction: Prediction | VolumePrediction

    @property
    def error_um(self) -> Floats:
        """Predicted error, (n, 3)."""
        return self.prediction.error_um

    @property
    def lower_um(self) -> Floats:
        """Lower bound, (n, 3)."""
        return self.prediction.lower_um

    @property
    def upper_um(self) -> Floats:
        """Upper bound, (n, 3)."""
        return self.prediction.upper_um

    @property
    def in_domain(self) -> Bools:
        """Whether each row is one to rely on, (n,)."""
        return self.prediction.in_domain

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns of the table that `thetacomp predict` writes, by name, each (n,)."""
        p = self.prediction
        out: dict[str, NDArray[Any]] = {"t_s": p.t_s}
        if isinstance(p, VolumePrediction):
            out |= {f"{axis}_mm": values for axis, values in p.positions_mm.items()}
            out["tool_length_mm"] = p.tool_length_mm
        else:
            out |= {"axis": np.array(p.axis, dtype=object), "position_mm": p.position_mm}
        out |= {f"d{d}_um": p.error_um[:, k] for k, d in enumerate(CARTESIAN)}
        for k, d in enumerate(CARTESIAN):
            out |= {f"d{d}_lo_um": p.lower_um[:, k], f"d{d}_hi_um": p.upper_um[:, k]}
        return out | {"in_domain": p.in_domain}

    def to_frame(self) -> pd.DataFrame:
        """The same as a pandas DataFrame."""
        require("pandas")
        import pandas as pd

        return pd.DataFrame(self.columns())

    def __repr__(self) -> str:
        size_um = np.where(np.isfinite(self.error_um), np.abs(self.error_um), -1.0).max(axis=0, initial=-1.0)
        largest = [f"|d{d}| {value:.1f}" for d, value in zip(CARTESIAN, size_um, strict=True) if value >= 0.0]
        outside = int((~self.in_domain).sum())
        return (
            f"PredictedError: {len(self.error_um)} rows, largest in µm: {', '.join(largest) or 'no value'};"
            f" {outside} outside the training"
        )


@dataclass(frozen=True, repr=False)
class Model:
    """A stored model. `document` is model.json."""

    document: ModelDocument

    def predict(
        self,
        temperatures: Temperatures | SingleTable,
        positions: Positions | SingleTable,
        *,
        duty: Duty | SingleTable | None = None,
        reference: Reference = "first_row",
    ) -> PredictedError:
        """The error at times and positions.

        `temperatures` is a table with a time column and one column a sensor (°C), `positions` one with t_s, axis and
        position_mm, or t_s and `<axis>_mm` of all axes; each a DataFrame, a mapping of arrays, or a file. `duty`
        (spindle_rpm) is needed where the model was trained with the spindle speed. `reference` is the moment of zero:
        "first_row", "model", or a time in s of the temperatures. Raises InputError, AnalysisError.
        """
        heat = temperatures if isinstance(temperatures, Temperatures) else read_temperatures(temperatures)
        wanted = positions if isinstance(positions, Positions) else read_positions(positions)
        work = duty if duty is None or isinstance(duty, Duty) else read_duty(duty)
        if not wanted.at_mm:
            return PredictedError(predict(self.document, heat, wanted, reference, duty=work))
        return PredictedError(
            predict_volume(self.document, heat, wanted.t_s, wanted.at_mm, wanted.tool_length_mm, reference, duty=work)
        )

    def save(self, path: Path | str) -> None:
        """Write model.json."""
        self.document.save(Path(path))

    def __repr__(self) -> str:
        m, failed = self.document, len(self.document.failed_checks)
        return (
            f"Model of {m.machine}, trained on {', '.join(m.training.campaigns)}; {m.form} form, sign {m.sign}\n"
            f"components: {', '.join(m.components)}\n"
            f"{f'{failed} acceptance checks failed' if failed else 'all acceptance checks passed'}"
        )


@dataclass(frozen=True, repr=False)
class Analysis:
    """What `analyze` found; `result` holds everything. A notebook shows verdict and picture, before and after."""

    result: AnalysisResult

    @property
    def model(self) -> Model:
        """The fitted model."""
        return Model(self.result.model)

    def table(self, name: str) -> pd.DataFrame:
        """A table that `thetacomp analyze` writes: separation, geometry, keypoints, validation, acceptance, …"""
        require("pandas")
        import pandas as pd

        from thetacomp.report.analysis_files import table_files

        tables = {Path(file).stem: text for file, text in table_files(self.result).items() if file.endswith(".csv")}
        if name not in tables:
            raise AnalysisError(f"this analysis has no table '{name}'. Fix: one of {', '.join(tables)}.")
        return pd.read_csv(StringIO(str(tables[name])))

    def save(self, out: Path | str) -> tuple[Path, ...]:
        """Write model.json, the tables, report.html and the figures into a folder; returns the paths."""
        from thetacomp.report.analysis_files import OWN, analysis_files

        return _folder(Path(out), OWN, analysis_files(self.result))

    def __repr__(self) -> str:
        return repr(self.result)

    def _repr_html_(self) -> str:
        from thetacomp.report.notebook import analysis_html

        return analysis_html(self.result)


@dataclass(frozen=True, repr=False)
class Verification:
    """Compensation off against on. `go` is the verdict, `result` holds everything."""

    result: VerificationResult

    @property
    def go(self) -> bool:
        """Whether every check is passed."""
        return self.result.go

    def save(self, out: Path | str) -> tuple[Path, ...]:
        """Write verification.html, tables and figures into a folder; returns the paths, the page first."""
        from thetacomp.report.verification import OWN, verification_files

        return _folder(Path(out), OWN, verification_files(self.result))

    def __repr__(self) -> str:
        r = self.result
        lines = [
            f"Verification of {r.machine.name}: {r.verdict},"
            f" off {', '.join(r.off.campaigns)}, on {', '.join(r.on.campaigns)}"
        ]
        lines += [f"cause: {cause.text}" for cause in r.causes]
        return "\n".join(lines)


def analyze(
    folder: MachineFolder | Path | str,
    *,
    train: str | Sequence[str] = (),
    test: str | Sequence[str] = (),
    repair: bool = True,
    mix: bool = False,
    compare: bool = False,
    progress: Progress = lambda message: None,
) -> Analysis:
    """The whole analysis: separation, key points, model, validation on held-out data.

    By default all campaigns train and each is held out in turn. `repair` corrects the faulty temperatures that
    screening finds; `mix` lets campaigns of different modes share a model; `compare` validates other families of models
    alongside the stored one (extra `families`). `progress` receives one line a step. Raises InputError, AnalysisError.
    """
    if compare:
        require("families")
    read = folder if isinstance(folder, MachineFolder) else read_folder(Path(folder))
    return Analysis(spine.analyze_folder(read, _names(train), _names(test), progress, repair, mix, compare))


def load_model(path: Path | str) -> Model:
    """A model.json. Raises ModelFileError."""
    return Model(load_stored(Path(path)))


def verify(
    folder: MachineFolder | Path | str,
    off: str | Sequence[str],
    on: str | Sequence[str],
    model: Model | Path | str | None = None,
    progress: Progress = lambda message: None,
) -> Verification:
    """Compare campaigns with compensation off and on; the expected error comes from `model`, else from `off`.

    Raises InputError, AnalysisError, ModelFileError.
    """
    read = folder if isinstance(folder, MachineFolder) else read_folder(Path(folder))
    known = None if model is None else _model(model).document
    return Verification(verify_folder(read, _names(off), _names(on), known, progress))


def export(
    model: Model | Path | str, target: str, out: Path | str, settings: Path | str | None = None
) -> tuple[Path, ...]:
    """Write the files that bring a model to a control; returns the paths.

    `settings` is the path of an export.toml. Raises InputError for bad settings, AnalysisError where nothing can be
    exported or the target is unknown.
    """
    from thetacomp.report.export import OWN, export_files

    if target not in TARGETS:
        raise AnalysisError(f"this version writes {', '.join(TARGETS)}, not '{target}'.")
    made = export_files(_model(model).document, target, None if settings is None else Path(settings))
    return _folder(Path(out), OWN, {file.name: file.text for file in made.files})


def _folder(out: Path, own: Sequence[str], files: Files) -> tuple[Path, ...]:
    """Write the files of a folder as the commands do: completely or not at all. Raises OutputError."""
    with output_folder(out, own=own) as fresh:
        write_files(fresh, files)
    return tuple(out / name for name in files)


def _model(model: Model | Path | str) -> Model:
    return model if isinstance(model, Model) else load_model(model)


def _names(campaigns: str | Sequence[str]) -> Sequence[str]:
    return (campaigns,) if isinstance(campaigns, str) else campaigns
