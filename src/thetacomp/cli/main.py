"""The `thetacomp` command. Each command is a thin file of its own; heavy imports happen inside the commands."""

from __future__ import annotations

from typing import Annotated

import typer

from thetacomp import __version__
from thetacomp.cli import analyze, check, demo, export, iso230, keypoints, place, plan, predict, trial, twin, verify

app = typer.Typer(
    name="thetacomp",
    help="Take the thermal error out of a machine tool: measure, separate, model, validate, compensate.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"thetacomp {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    """Options of the command as a whole."""


app.command("demo")(demo.demo)
app.command("check")(check.check)
app.command("plan")(plan.plan)
app.command("keypoints")(keypoints.keypoints)
app.command("analyze")(analyze.analyze)
app.command("predict")(predict.predict)
app.command("verify")(verify.verify)
app.command("export")(export.export)
app.command("iso230")(iso230.iso230)
app.command("twin")(twin.twin)
app.command("place")(place.place)
app.command("trial")(trial.trial)


if __name__ == "__main__":
    app()
