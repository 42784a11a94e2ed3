"""What a person gets from a solve: the HTML report, and a summary for the terminal."""

from solver.report.report import ReportError, render, render_sensitivity, write_report
from solver.report.summary import Summary, summary

__all__ = ["ReportError", "Summary", "render", "render_sensitivity", "summary", "write_report"]
