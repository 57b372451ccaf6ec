"""Lets `python -m thetacomp` run the command."""

from thetacomp.cli.main import app

app()
