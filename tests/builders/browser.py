"""A page as a browser shows it: what is visible, what it requests, what its scripts print."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.image import imread

OWN_BROWSER_TRAFFIC = (
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--host-resolver-rules=MAP * ~NOTFOUND",
)


@dataclass(frozen=True)
class View:
    """A page in a browser: its pixels (height, width, 3) in 0..1, the URLs it requested, what its scripts printed."""

    pixels: np.ndarray
    requests: tuple[str, ...]
    console: tuple[str, ...]


def open_in_browser(page: Path, folder: Path, height: int = 3000) -> View:
    """Open a local page in a fresh, headless browser without a network."""
    picture, log = folder / "page.png", folder / "net.json"
    done = subprocess.run(
        [
            "chromium",
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            *OWN_BROWSER_TRAFFIC,
            f"--user-data-dir={folder / 'profile'}",
            f"--window-size=1200,{height}",
            "--enable-logging=stderr",
            f"--log-net-log={log}",
            f"--screenshot={picture}",
            "--virtual-time-budget=5000",
            page.as_uri(),
        ],
        capture_output=True,
        text=True,
        errors="replace",
        timeout=60,
        check=False,
    )
    assert picture.exists(), done.stderr
    return View(
        pixels=imread(picture)[..., :3],
        requests=tuple(_requests_of_the_page(log)),
        console=tuple(re.findall(r"CONSOLE[^\]]*\] (.*)", done.stderr)),
    )


def _requests_of_the_page(log: Path) -> list[str]:
    """URLs that the page itself requested; requests of the browser have no page as their initiator."""
    found = json.loads(log.read_text(encoding="utf-8"))
    start = found["constants"]["logEventTypes"]["URL_REQUEST_START_JOB"]
    starts = (event["params"] for event in found["events"] if event["type"] == start and "params" in event)
    return [p["url"] for p in starts if "url" in p and p.get("initiator") != "not an origin"]
