"""Reading of machine folders and tables: numbers that are checked once, or all problems at once."""

from thetacomp.reading.correlations import read_correlations
from thetacomp.reading.folder import check_folder, read_folder, read_machine
from thetacomp.reading.frames import read_frames
from thetacomp.reading.positioning import read_positioning
from thetacomp.reading.single_tables import Positions, read_duty, read_positions, read_temperatures
from thetacomp.reading.summary import CampaignSummary, FolderSummary, summarize

__all__ = [
    "CampaignSummary",
    "FolderSummary",
    "Positions",
    "check_folder",
    "read_correlations",
    "read_duty",
    "read_folder",
    "read_frames",
    "read_machine",
    "read_positioning",
    "read_positions",
    "read_temperatures",
    "summarize",
]
