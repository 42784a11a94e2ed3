"""What the whole run tells: a failure is named when it happens, not only at the end.

A run that is ended before its time, by its computer or by an impatient reader, has said by then what
went wrong.
"""

from __future__ import annotations

import pytest


class _Told:
    """Names each failure on the terminal at once."""

    def __init__(self, terminal: pytest.TerminalReporter) -> None:
        self._terminal = terminal

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.failed:
            return
        crash = getattr(report.longrepr, "reprcrash", None)
        why = crash.message if crash is not None else str(report.longrepr)
        first = why.splitlines()[0] if why else ""
        self._terminal.line("")
        self._terminal.write_line(f"{report.nodeid} failed in its {report.when}: {first}", red=True)


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    terminal = config.pluginmanager.get_plugin("terminalreporter")
    if terminal is not None:
        config.pluginmanager.register(_Told(terminal), "told-at-once")
