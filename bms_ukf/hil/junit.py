"""Results as JUnit XML, which every CI reads: a suite a scenario, a case an expectation."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

from bms_ukf.errors import ConfigError
from bms_ukf.hil.result import Result

_PROPERTIES = ("file", "interface", "seed", "trace_sha256", "duration_s", "realtime_factor", "overruns")


def write(path: Path, results: Sequence[Result]) -> None:
    """Raises ConfigError if `path` cannot be written."""
    root = ET.Element("testsuites", name="bms-ukf hil")
    for result in results:
        root.append(_suite(result))
    ET.indent(root)
    try:
        ET.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise ConfigError(path, expected=f"a file that can be written ({error.strerror})") from None


def _suite(result: Result) -> ET.Element:
    failed = sum(not verdict.passed for verdict in result.verdicts)
    skipped = int(result.record is None)
    counts = {"tests": len(result.verdicts) + skipped, "failures": failed, "errors": 0, "skipped": skipped}
    suite = ET.Element("testsuite", name=result.name, time=f"{result.wall_s:.3f}")
    for key, count in counts.items():
        suite.set(key, str(count))
    properties = ET.SubElement(suite, "properties")
    summary = result.summary()
    for name in _PROPERTIES:
        ET.SubElement(properties, "property", name=name, value=str(summary[name]))
    if result.record is None:
        case = ET.SubElement(suite, "testcase", name="run", classname=f"hil.{result.name}")
        ET.SubElement(case, "skipped", message=f"not run: {result.reason}")
    for verdict in result.verdicts:
        case = ET.SubElement(suite, "testcase", name=verdict.wanted, classname=f"hil.{result.name}")
        if not verdict.passed:
            message = f"wanted {verdict.wanted}; found {verdict.found}"
            ET.SubElement(case, "failure", message=message, type="expectation").text = message
    return suite
