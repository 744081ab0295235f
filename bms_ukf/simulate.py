"""`bms-ukf demo` and `cosim`: a scenario run before the user's eyes, its verdict, its trace and its report."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from bms_ukf import cosim, metrics, scenario

log = logging.getLogger(__name__)


def simulate(
    given: str, *, out: Path | None = None, report: Path | None = None, judged: bool = False
) -> dict[str, Any]:
    """Run a scenario, in a file or shipped; write trace and report if asked for. Returns the summary.

    `judged`: hold the result against the project's goals. They are the demo's, and need not be those of another plant.
    """
    from bms_ukf.view import LiveView, verdict

    found, path = scenario.load(given)
    if found.fault or found.expect:
        log.warning("%s: without its faults and expectations, which are for bms-ukf hil", path)
    with LiveView(found.name) as view:
        trace, summary = cosim.run(found, path, view.update)
    page = None
    if out is not None:
        trace.write_csv(out)
    if report is not None:
        from bms_ukf.report.html import write_report

        page = write_report(report, trace, summary, title=found.name)
    verdict(summary, page, judged=judged)
    return summary


def passed(summary: dict[str, Any]) -> bool:
    """Whether a run reached the project's goals."""
    return all(check.passed for check in metrics.judge(summary))
