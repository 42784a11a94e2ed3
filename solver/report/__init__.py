"""What a person gets from a solve: the HTML report, and a summary for the terminal."""

from solver.report.report import ReportError, render, write_report
from solver.report.summary import Summary, summary

__all__ = ["ReportError", "Summary", "render", "summary", "write_report"]
