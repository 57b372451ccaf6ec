"""What all tests share: marks for system packages and shared data, and a count of what was skipped for want of them."""

from __future__ import annotations

import os
import shutil
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SHARED_DATA = ROOT.parent / "shared" / "data"
PACKAGE_MISSING = "a package is missing: "
DATA_ABSENT = "shared data is absent: "


def pytest_configure(config: pytest.Config) -> None:
    os.environ["COLUMNS"] = "120"  # commands wrap at the width of the console: the same for every test run
    config.addinivalue_line("markers", "needs(package): a system package of scripts/packages.txt")
    config.addinivalue_line("markers", "shared_data(path): a file under ../shared/data, see the fixture `shared_data`")


def packages() -> dict[str, bool]:
    """Every package of scripts/packages.txt, and whether it is there."""
    found = {}
    for line in (ROOT / "scripts" / "packages.txt").read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            package, kind, probe = line.split()
            found[package] = shutil.which(probe) is not None if kind == "command" else Path(probe).exists()
    return found


def pytest_runtest_setup(item: pytest.Item) -> None:
    known = packages()
    missing = [name for mark in item.iter_markers("needs") for name in mark.args if not known[name]]
    if missing:
        reason = PACKAGE_MISSING + " ".join(missing)
        # The check of every change allows no such skip: there the packages are installed.
        if os.environ.get("THETACOMP_NO_SKIPS") == "1":
            pytest.fail(reason, pytrace=False)
        pytest.skip(reason)
    for mark in item.iter_markers("shared_data"):
        if not (SHARED_DATA / mark.args[0]).exists():
            pytest.skip(DATA_ABSENT + mark.args[0])


@pytest.fixture
def shared_data(request: pytest.FixtureRequest) -> Path:
    """The file that the test's mark `shared_data(path)` names."""
    mark = request.node.get_closest_marker("shared_data")
    return SHARED_DATA / mark.args[0]


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> Generator[None]:
    """Names what was skipped for want of a package or of shared data, below everything but the closing counts."""
    yield
    groups: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for report in terminalreporter.stats.get("skipped", []):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        for kind in (PACKAGE_MISSING, DATA_ABSENT):
            if kind in reason:
                groups[kind, reason.split(kind, 1)[1]].append(report.nodeid)
    for (kind, name), tests in sorted(groups.items()):
        terminalreporter.write_line(f"skipped, because {kind}{name} ({len(tests)}): {', '.join(sorted(tests))}")
