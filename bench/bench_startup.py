"""Start-up: what a user waits for `thetacomp --help`, against Python alone and against importing NumPy."""

from __future__ import annotations

import sys

from timing import side_by_side


def main() -> None:
    python = sys.executable
    side_by_side(
        "Start-up",
        {
            "import numpy": [python, "-c", "import numpy"],
            "python -c pass": [python, "-c", "pass"],
            "thetacomp --help": [python, "-m", "thetacomp", "--help"],
            "import pandas, sklearn, matplotlib": [python, "-c", "import pandas, sklearn, matplotlib"],
        },
        rounds=9,
    )
