"""The export targets of this version: a model and a settings file in, the files of the target out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from thetacomp.arrays import Floats
from thetacomp.controllers.base import Export, ExportFile, read_settings
from thetacomp.controllers.sinumerik import plan_registers
from thetacomp.controllers.sinumerik_files import sag_tables, temperature_program, values_csv
from thetacomp.controllers.sinumerik_remarks import remarks
from thetacomp.controllers.sinumerik_replay import CampaignReplay, replay_campaign
from thetacomp.controllers.sinumerik_settings import SinumerikSettings
from thetacomp.model.document import ModelDocument

CEC_FILE = "sinumerik_cec.ini"


def export_sinumerik(model: ModelDocument, settings_path: Path | None) -> Export:
    """The files that a SINUMERIK 840D sl or ONE reads, and its plan.

    Raises InputError where the settings do not fit, AnalysisError where nothing can be exported.
    """
    settings = read_settings(settings_path, SinumerikSettings)
    plan = plan_registers(model, settings, str(settings_path or "export.toml"))
    files = [ExportFile("sinumerik_temperature_compensation.spf", temperature_program(plan))]
    if plan.tables:
        files.append(ExportFile(CEC_FILE, sag_tables(plan)))
    files.append(ExportFile("sinumerik_values.csv", values_csv(plan)))
    return Export(tuple(files), plan, remarks(plan), () if plan.tables else (CEC_FILE,))


def replay_sinumerik(
    model: ModelDocument,
    settings_path: Path | None,
    campaign: str,
    t_s: Floats,
    temperature_degC: Mapping[str, Floats],
) -> CampaignReplay:
    """The temperatures of a measured campaign, from its zero on, through a SINUMERIK and its writer."""
    return replay_campaign(model, read_settings(settings_path, SinumerikSettings), campaign, t_s, temperature_degC)


TARGETS: Mapping[str, Callable[[ModelDocument, Path | None], Export]] = {"sinumerik": export_sinumerik}
Replay = Callable[[ModelDocument, Path | None, str, Floats, Mapping[str, Floats]], CampaignReplay]
REPLAYS: Mapping[str, Replay] = {"sinumerik": replay_sinumerik}
