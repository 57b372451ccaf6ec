"""`thetacomp demo`: every command of a first day, run on the bundled machine, with a line on what each one is for."""

from __future__ import annotations

import csv
import io
import json
import shlex
from contextlib import redirect_stdout
from dataclasses import astuple, fields
from pathlib import Path
from typing import Annotated, Any

import typer

from thetacomp.cli.common import DONE, NOT_FIT, JsonOption, Outcome, run
from thetacomp.errors import AnalysisError
from thetacomp.files import write_file, write_files
from thetacomp.table_file import csv_text

INTRODUCTION = """\
The machine: a TK6920 floor-type boring and milling machine, measured with a laser tracker while it warmed up.
The numbers: the published tables of Cui, Gao and Yao (2012), slope and intercept of nine error components over time.
Three campaigns (X, Y, W) with one temperature each, so there no sensor is left to choose.
Copied to {folder}: look there for the format.
"""

CLOSING = """\
What to remember about these numbers
- They are not fit for use on a machine, and every file says so: the publication does not state the sign of the
  errors, and its temperatures had to be reconstructed from the errors. They check the arithmetic, not the physics,
  and cannot be compared with the published 71 % and 64 %, which come from a separate compensated run.
- Compare the clock with the thermometer: on this one warm-up, elapsed time alone does about as well. Only a second
  campaign with another duty can distinguish the two. That is why every validation shows the clock.

Open these files
  {report}  the report: start here
  {model}  the model, with its equations
  {sheet}  the sheet that belongs to the controller data in the same folder
  {folder}  the input: put your own measurements into such a folder

Then, with your own machine
  thetacomp check my-machine
  thetacomp analyze my-machine --out results"""


def demo(
    context: typer.Context,
    out: Annotated[Path, typer.Option("--out", help="Folder for input, results and controller data.")] = Path(
        "thetacomp-demo"
    ),
    as_json: JsonOption = False,
) -> None:
    """Run all steps on the bundled machine, then say which files to open."""
    run(lambda: _demo(context, out, as_json), as_json)


def _demo(context: typer.Context, out: Path, as_json: bool) -> Outcome:
    folder, results, control = out / "tk6920", out / "results", out / "sinumerik"
    model, positions, reasons = results / "model.json", out / "positions.csv", out / "keypoints.txt"
    _copy_example(folder)
    _write_positions(positions)
    steps: list[dict[str, Any]] = []

    def say(text: str = "") -> None:
        if not as_json:
            typer.echo(text)

    def do(purpose: str, *command: str | Path) -> str:
        """Say what comes, run it, and return its words without printing them."""
        arguments = [str(part) for part in command]
        say(f"{len(steps) + 1}. {purpose}\n   $ {_printed(arguments)}\n")
        words, data = _run_command(context, arguments, as_json)
        steps.append({"command": arguments, **data})
        return words

    say(INTRODUCTION.format(folder=folder))
    say(do("Is the folder readable and complete?", "check", folder))

    tables = (folder / "parameter_correlations.csv", folder / "sensor_correlations.csv")
    words = do(
        "Which sensors matter? The paper's way, from its correlation tables alone.",
        *("keypoints", folder, "--parameter-correlations", tables[0], "--sensor-correlations", tables[1]),
    )
    if not as_json:
        write_file(reasons, words)
        summary = words.partition("\n\n")[0]
        say(f"{summary}\nWhy each sensor stayed or went: {reasons}\n")

    say(do("Separate, choose, fit, test on states the model has not seen.", "analyze", folder, "--out", results))
    say(_in_short(results))
    say(_against_print(folder, out / "equations_compared.csv"))
    temperatures = folder / "campaigns" / "Y" / "temperatures.csv"
    words = do(
        "Which error does the model expect along the column (axis Y), hour by hour?",
        *("predict", model, "--temperatures", temperatures, "--positions", positions, "--out", out / "prediction.csv"),
    )
    say(words)
    say(do("Data for a SINUMERIK control.", "export", model, "--target", "sinumerik", "--out", control))
    text = CLOSING.format(
        report=results / "report.html", model=model, sheet=control / "commissioning_sheet.html", folder=folder
    )
    return Outcome(text, {"steps": steps, "folder": str(out)})


def _printed(arguments: list[str]) -> str:
    """The command as it can be typed, one option a line where it is long."""
    line = shlex.join(["thetacomp", *arguments])
    return line if len(line) < 100 else line.replace(" --", " \\\n       --")


def _run_command(context: typer.Context, arguments: list[str], as_json: bool) -> tuple[str, dict[str, Any]]:
    """Run another command of the same program in this process: its words and, on demand, its data.

    "Not fit for use" is the right end for the bundled data. AnalysisError where a command ends otherwise.
    """
    json_option = ["--json"] if as_json else []
    thetacomp = context.find_root().command
    words = io.StringIO()
    with redirect_stdout(words):
        exit_code = thetacomp.main([*arguments, *json_option], "thetacomp", standalone_mode=False) or DONE
    if exit_code not in (DONE, NOT_FIT):
        raise AnalysisError(f"`{_printed(arguments)}` ended with exit code {exit_code}.\n{words.getvalue()}")
    return words.getvalue(), json.loads(words.getvalue()) if as_json else {}


def _in_short(results: Path) -> str:
    """The column deviation held out in two ways, model and clock, from the tables of the analysis."""
    lines = ["In short: reduction of the largest column deviation, on data that the model has not seen"]
    for file, held_out in (
        ("validation.csv", "each state in turn"),
        ("validation_forward.csv", "second half of the warm-up"),
    ):
        with (results / file).open(newline="", encoding="utf-8") as table:
            rows = {(row["component"], row["model"]): row for row in csv.DictReader(table)}
        for direction in "XZ":
            row, clock = rows[f"column_{direction}", "default"], rows[f"column_{direction}", "clock"]
            before_um, after_um = float(row["max_before_um"]), float(row["max_after_um"])
            model_percent, clock_percent = float(row["reduction_percent"]), float(clock["reduction_percent"])
            lines.append(
                f"  {direction}, {held_out:<27}{before_um:4.0f} -> {after_um:3.0f} µm  {model_percent:5.1f} %"
                f"   the clock alone {clock_percent:5.1f} %"
            )
    return "\n".join(lines) + "\n"


def _against_print(folder: Path, path: Path) -> str:
    """Our coefficients against the publication's equations (3) to (11); the full table goes to `path`."""
    from thetacomp.examples import TK6920_EQUATIONS
    from thetacomp.reading import read_folder
    from thetacomp.validation.published import compare_with_published, read_published_equations

    rows = compare_with_published(read_published_equations(TK6920_EQUATIONS), read_folder(folder))
    columns = [field.name for field in fields(rows[0])]
    write_file(path, csv_text(columns, map(astuple, rows), "\r\n"))
    strong = [row for row in rows if row.coefficient.endswith("per °C") and row.verdict != "weak"]
    close = [row for row in strong if row.verdict != "differs"]
    turned = sorted({(row.equation, row.component) for row in rows if row.verdict == "reversed"})
    reversed_text = ", ".join(f"({number}), {component}," for number, component in turned)
    return (
        "The printed equations against the tables, fitted the paper's way\n"
        f"  {len(close)} of {len(strong)} temperature coefficients with |r| > 0.9 agree in size within 10 %\n"
        f"  equation {reversed_text} is printed with both signs reversed against the tables\n"
        f"  every coefficient: {path}\n"
    )


def _copy_example(folder: Path) -> None:
    from thetacomp.examples import TK6920

    found = sorted(path for path in TK6920.rglob("*") if path.is_file())
    write_files(folder, {path.relative_to(TK6920).as_posix(): path.read_bytes() for path in found})


def _write_positions(path: Path) -> None:
    """Where a prediction is wanted: every 500 mm of the column, each hour of the warm-up."""
    rows = [(3600 * hour, "Y", 500 * step) for hour in range(8) for step in range(7)]
    write_file(path, csv_text(("t_s", "axis", "position_mm"), rows, "\r\n"))
