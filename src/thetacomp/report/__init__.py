"""The report: every picture once, and one page that holds them."""

from thetacomp.report.page import write_report

__all__ = ["write_report"]
