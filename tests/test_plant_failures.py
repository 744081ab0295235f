"""FMUs that hang, crash, leak, give NaN, refuse or print: each is named, and none takes this process with it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from c_fmu import CELL, CELL_STEP, build

from bms_ukf.errors import ConfigError, PlantError
from bms_ukf.plant import open_plant

SECOND = 1_000_000_000
LATE = "if (t < 2.5) {" + CELL_STEP.replace("return 0;", "return 0; }")  # what follows happens in the step from 3 s on
# So many MB, which stay in use.
TAKE = "{{ volatile char *p = malloc({0} << 20); for (int k = 0; k < {0} << 20; k += 512) p[k] = 1; usleep(10000); }}"


def drive(plant, seconds):
    for _ in range(seconds):
        plant.step(1.0, SECOND)


def run(fmu, seconds=10, **keys):
    """The failure of a plant, and the time it was at."""
    with open_plant(fmu, **keys) as plant:
        with pytest.raises(PlantError) as caught:
            drive(plant, seconds)
        pids = [part.process.pid for part in plant._parts]
        t_ns = plant.state.t_ns
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert "\n" not in str(caught.value)
    assert str(fmu) in str(caught.value)
    return caught.value, t_ns


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize(
    ("code", "kind", "text"),
    [
        ("for (;;) usleep(1000);", "hang", "no answer within 0.5 s in fmi{}DoStep"),
        ("abort();", "crash", "SIGABRT"),
        ("*(volatile int *)0 = 1;", "crash", "SIGSEGV"),
        ('fputs("no licence\\n", stderr); exit(3);', "crash", "exit code 3 in fmi{}DoStep, saying 'no licence'"),
        ("voltage_V = 0.0 / 0.0; return 0;", "nan", "outputs at t = 4 s: voltage_V = nan"),
        ("return 3;", "refused", "at t = 3 s: fmi{}DoStep returned error: the FMU gives no reason"),
        ("return 4;", "refused", "returned fatal"),
        ("*reached = -1; return STOPPED;", "refused", "the FMU ended the simulation"),
    ],
    ids=["hang", "abort", "segv", "exit", "nan", "error", "fatal", "ended"],
)
def test_a_failure_in_a_step_is_told_by_its_kind(tmp_path, fmi, code, kind, text):
    fmu = build(tmp_path / "bad.fmu", step=LATE + code.replace("STOPPED", "2" if fmi == 2 else "0"), fmi=fmi)
    error, t_ns = run(fmu, deadline_s=0.5 if kind == "hang" else 10.0)
    assert error.kind == kind
    assert text.format(fmi) in str(error)
    assert t_ns == 3 * SECOND


def test_memory_that_grows_without_end_is_stopped_at_the_limit(tmp_path):
    leak = TAKE.format(20) + CELL_STEP
    error, _ = run(build(tmp_path / "leak.fmu", step=leak), seconds=1000, memory_limit_MB=200)
    assert error.kind == "memory"
    assert "memory_limit_MB = 200" in str(error)


def test_memory_is_watched_within_a_step_too(tmp_path):
    leak = "for (;;) {" + TAKE.format(5) + "}"
    error, _ = run(build(tmp_path / "leak.fmu", step=leak), memory_limit_MB=200, deadline_s=60.0)
    assert error.kind == "memory"


def test_a_plant_that_prints_without_end_runs_as_one_that_does_not(tmp_path):
    noise = 'for (int i = 0; i < 3000; i++) puts("Licence will expire in 12 days, contact your vendor");' + CELL_STEP
    with open_plant(build(tmp_path / "noisy.fmu", step=noise)) as plant:
        for _ in range(5):
            plant.step(1.0, SECOND)
        assert plant.state.t_ns == 5 * SECOND
        assert "Licence will expire" in plant._parts[0].process.said


def test_what_an_fmu_prints_does_not_reach_our_output(tmp_path, capfd):
    with open_plant(build(tmp_path / "noisy.fmu", step='puts("noise"); fflush(stdout);' + CELL_STEP)) as plant:
        plant.step(1.0, SECOND)
    assert capfd.readouterr() == ("", "")


def test_a_prompt_for_a_licence_finds_neither_terminal_nor_display(tmp_path):
    ask = 'if (getchar() == EOF && !getenv("DISPLAY")) { fputs("no licence\\n", stderr); return NULL; }'
    with pytest.raises(ConfigError, match=r"loaded here .*no licence"):
        open_plant(build(tmp_path / "ask.fmu", instantiate=ask))


@pytest.mark.parametrize(
    ("code", "kind", "text"),
    [
        ("for (;;) usleep(1000);", "hang", "no answer within 0.5 s in fmi2Instantiate (does it wait for a licence"),
        ("abort();", "crash", "SIGABRT in fmi2Instantiate"),
    ],
    ids=["hang", "abort"],
)
def test_a_failure_while_starting_names_the_call(tmp_path, monkeypatch, code, kind, text):
    monkeypatch.setattr("bms_ukf.plant.process.START_DEADLINE_S", 0.5)
    with pytest.raises(PlantError) as caught:
        open_plant(build(tmp_path / "bad.fmu", instantiate=code), deadline_s=0.1)
    assert caught.value.kind == kind
    assert text in str(caught.value)


def test_a_crash_at_the_end_is_nobodys_concern(tmp_path):
    fmu = build(tmp_path / "bad.fmu", declare="__attribute__((destructor)) static void last(void) { abort(); }")
    with open_plant(fmu) as plant:
        assert plant.step(1.0, SECOND).t_ns == SECOND


def test_a_killed_plant_fails_as_a_crash_does_and_again(tmp_path):
    with open_plant(build(tmp_path / "cell.fmu")) as plant:
        plant.step(1.0, SECOND)
        plant.kill()
        for _ in range(2):
            with pytest.raises(PlantError, match="SIGKILL") as caught:
                plant.step(1.0, SECOND)
            assert caught.value.kind == "crash"
        assert plant.state.t_ns == SECOND


def test_a_paused_plant_fails_as_a_hang_does(tmp_path):
    with open_plant(build(tmp_path / "cell.fmu"), deadline_s=0.3) as plant:
        plant.pause()
        with pytest.raises(PlantError, match=r"no answer within 0\.3 s") as caught:
            plant.step(1.0, SECOND)
        assert caught.value.kind == "hang"


def test_a_plant_can_be_opened_again_after_it_failed(tmp_path):
    fmu = build(tmp_path / "cell.fmu")
    with open_plant(fmu) as plant:
        plant.kill()
    with open_plant(fmu) as plant:
        assert plant.step(1.0, SECOND).t_ns == SECOND


def test_a_process_an_fmu_starts_is_ended_with_it(tmp_path):
    fork = "if (soc_initial == 0.5) { soc_initial = 0.4; soc = fork(); if (soc == 0) for (;;) sleep(1); return 0; }"
    with open_plant(build(tmp_path / "fork.fmu", step=fork + CELL_STEP)) as plant:
        plant.step(1.0, SECOND)
        grandchild = int(plant.state.soc)
        assert Path(f"/proc/{grandchild}").exists()
    assert ended(grandchild)


def test_a_plant_does_not_outlive_the_process_that_started_it(tmp_path):
    fmu = build(tmp_path / "hang.fmu", step="for (;;) usleep(1000);")
    code = (
        "import sys; from bms_ukf.plant import open_plant; plant = open_plant(sys.argv[1]);"
        "print(plant._parts[0].process.pid, flush=True); plant.step(1.0, 10**9)"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "TMPDIR": str(tmp_path)}
    with subprocess.Popen([sys.executable, "-c", code, str(fmu)], stdout=subprocess.PIPE, env=environment) as parent:
        pid = int(parent.stdout.readline())
        parent.send_signal(signal.SIGKILL)
    assert ended(pid)


def ended(pid: int) -> bool:
    """Waits for a process that is not ours to wait for."""
    for _ in range(500):
        try:
            state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
        except (FileNotFoundError, ProcessLookupError):
            return True
        if state in "ZX":
            return True
        time.sleep(0.02)
    return False


def test_the_voltage_names_a_lost_cell(tmp_path):
    broken = CELL_STEP.replace("return 0;", "if (t > 1) soc = 1.0 / 0.0; return 0;")
    error, _ = run(build(tmp_path / "bad.fmu", CELL, broken))
    assert "soc = inf" in str(error)
