"""No frame that was damaged, made up or replayed ends the daemon, or brings it to publish a wrong SoC as valid."""

from __future__ import annotations

import fuzz


def test_thousands_of_damaged_frames_change_neither_the_daemon_nor_its_soc() -> None:
    found = fuzz.run(20_000)
    assert found.refused > 5_000
    assert found.published > 1_000
    assert found.worst < 0.005
