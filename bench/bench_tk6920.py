"""The TK6920 job, files to report, against merely importing the libraries that such a job stands on."""

from __future__ import annotations

import sys
import tempfile

from timing import side_by_side

from thetacomp.examples import TK6920

NOT_FIT_FOR_USE = 3  # the expected end: the sign of the published data is not proven


def main() -> None:
    python = sys.executable
    libraries = "import pandas, sklearn.linear_model, scipy.stats, matplotlib.figure"
    with tempfile.TemporaryDirectory() as out:
        side_by_side(
            "The TK6920 job",
            {
                "import of the libraries alone": [python, "-c", libraries],
                "thetacomp check": [python, "-m", "thetacomp", "check", str(TK6920)],
                "thetacomp analyze": [python, "-m", "thetacomp", "analyze", str(TK6920), "--out", out],
            },
            rounds=5,
            expected_exit=(0, NOT_FIT_FOR_USE),
        )
