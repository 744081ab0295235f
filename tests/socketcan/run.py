"""Run the tests marked `socketcan` over a real vcan0, on this kernel or in a User Mode Linux guest.

Native: a network namespace of its own, so that no interface of the host is touched (root, or unprivileged namespaces).
Guest: the host's file system read-only, one slow CPU; the result comes back through files, since the exit code of
`linux.uml` says nothing about the tests. No privileges are needed.
Tests that failed in a guest run once more in a freshly booted one, and are named: its emulated kernel stalls for tens
of seconds, or panics, on a busy host. Nothing runs twice on a real kernel.
Where neither is possible, the tests not run are named; that is an error only if REQUIRE_SOCKETCAN=1.
"""

from __future__ import annotations

import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
TIME_LIMIT_S = 1800.0
CACHE = Path(os.environ.setdefault("NUMBA_CACHE_DIR", str(ROOT / ".numba_cache")))
PYTEST = [sys.executable, "-m", "pytest", "-m", "socketcan", "-p", "no:cacheprovider"]
WITH_VCAN0 = ["sh", "-c", 'ip link add dev vcan0 type vcan && ip link set vcan0 up && exec "$@"', "sh"]
PASSED_TO_GUEST = ("BMS_UKF_", "COLUMNS", "LANG", "NUMBA_", "PATH", "PYTEST_")
PACKAGES = "user-mode-linux kmod iproute2 can-utils"


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="socketcan-") as folder:
        work = Path(folder)
        command, junit = select(work, "all", [str(HERE)])
        if (why_not_native := native_obstacle()) is None:
            where = f"native kernel {platform.release()}"
            announce(f"SocketCAN: vcan0 on the {where}")
            code = run_limited([*namespace(), *WITH_VCAN0, *command], cwd=ROOT)
        elif (why_no_guest := guest_obstacle()) is None:
            where = f"User Mode Linux guest, kernel {guest_kernel()}"
            announce(f"SocketCAN: vcan0 in a {where} (native: {why_not_native})")
            code = run_guest(command, work)
            if code and (again := failed(junit)):
                names = "\n".join(again)
                announce(f"{len(again)} failed, and run once more in a fresh guest:\n{names}")
                code = run_guest(select(work, "again", again)[0], work)
                where += f"; {len(again)} of them at the second boot, see above"
        else:
            return not_run(why_not_native, why_no_guest)
        ran, skipped = count(junit)
        say("\n".join(f"{name}: {value}" for name, value in measured(junit)))
    announce(f"{ran} tests ran over real vcan0 ({where}), {skipped} skipped, pytest exit code {code}")
    return code or int(ran == 0)


def select(work: Path, name: str, tests: list[str]) -> tuple[list[str], Path]:
    """The command that runs these tests, and where it leaves its result."""
    junit = work / f"{name}.xml"
    colour = "yes" if sys.stdout.isatty() else "no"
    # xunit1 has the properties that tests record
    return [
        *PYTEST,
        *tests,
        f"--junitxml={junit}",
        "--override-ini=junit_family=xunit1",
        f"--basetemp={work / name}",
        f"--color={colour}",
    ], junit


def namespace() -> list[str]:
    """The command prefix that gives a program its own network interfaces."""
    return ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--net", "--user", "--map-root-user"]


def native_obstacle() -> str | None:
    """Why vcan0 cannot be made on this kernel, or None."""
    if missing := [tool for tool in ("unshare", "ip", "candump") if not shutil.which(tool)]:
        return f"no {', '.join(missing)}"
    if os.geteuid() == 0 and shutil.which("modprobe"):
        subprocess.run(["modprobe", "--quiet", "vcan"], capture_output=True, check=False)
    probe = subprocess.run([*namespace(), *WITH_VCAN0, "true"], capture_output=True, text=True, check=False)
    return None if probe.returncode == 0 else f"vcan: {probe.stderr.strip() or 'not available'}"


def guest_obstacle() -> str | None:
    """Why no User Mode Linux guest can be started, or None."""
    if missing := [
        tool for tool in ("linux.uml", "insmod", "ip", "candump") if not shutil.which(tool, path=tool_path())
    ]:
        return f"no {', '.join(missing)}"
    if needs_padding() and not shutil.which("cc"):
        return "this processor has AMX, for which a C compiler is needed (apt install gcc libc6-dev)"
    return None


def tool_path() -> str:
    """PATH with the folders of the administrator's tools, which a user's own PATH lacks on Debian."""
    return f"{os.environ['PATH']}:/usr/sbin:/sbin"


def needs_padding() -> bool:
    return " amx_tile" in Path("/proc/cpuinfo").read_text()


def guest_kernel() -> str:
    return subprocess.run(["linux.uml", "--version"], capture_output=True, text=True, check=True).stdout.strip()


def run_guest(command: list[str], work: Path) -> int:
    """Boot the guest, let it run `command` in the checkout, and return the command's exit code."""
    CACHE.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(HERE / "uml_init.sh", work / "init")
    (work / "init").chmod(0o755)
    environment = {key: value for key, value in os.environ.items() if key.startswith(PASSED_TO_GUEST)}
    environment |= {"PATH": tool_path(), "HOME": str(work), "TMPDIR": str(work), "PYTHONDONTWRITEBYTECODE": "1"}
    lines = [f"export {key}={shlex.quote(value)}" for key, value in environment.items()]
    lines += [f"mount -t hostfs -o {shlex.quote(str(CACHE))} none {shlex.quote(str(CACHE))}"]
    lines += [f"cd {shlex.quote(str(ROOT))}", shlex.join(command)]
    (work / "command").write_text("\n".join(lines) + "\n")

    (work / "exit_code").unlink(missing_ok=True)
    boot = ["linux.uml", "mem=2G", "root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro", f"init={work / 'init'}"]
    boot += ["con=null", "con0=null,fd:2", "con1=fd:0,fd:1", "quiet", f"uml_dir={work}/"]
    host = dict(os.environ)
    if needs_padding():
        host["LD_PRELOAD"] = str(build_padding(work))
    with (work / "kernel.log").open("w") as log:
        run_limited(boot, cwd="/", env=host, stdin=subprocess.DEVNULL, stderr=log)
    if (work / "exit_code").exists():
        return int((work / "exit_code").read_text())
    say((work / "kernel.log").read_text(errors="replace")[-3000:])
    return 1


def run_limited(command: list[str], **options: Any) -> int:
    """Run a command for at most TIME_LIMIT_S; whatever it has started by then is killed with it."""
    started = time.monotonic()
    process = subprocess.Popen(command, start_new_session=True, **options)
    try:
        process.wait(TIME_LIMIT_S)
    except subprocess.TimeoutExpired:
        say(f"killed after {TIME_LIMIT_S:.0f} s")
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)  # a guest's processes are processes of the host, in its group
            process.wait()
    say(f"took {time.monotonic() - started:.1f} s")
    return process.returncode


def build_padding(work: Path) -> Path:
    library = work / "uml_xstate.so"
    flags = ["-std=gnu11", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "-o", str(library), str(HERE / "uml_xstate.c"), "-ldl"], check=True)
    return library


def failed(junit: Path) -> list[str]:
    """The tests that failed, as pytest wants them named; none if the guest did not come to its end."""
    if not junit.exists():
        return []
    cases = [
        case for case in ET.parse(junit).getroot().iter("testcase") if {"failure", "error"} & {e.tag for e in case}
    ]
    return sorted({f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}" for case in cases})


def measured(junit: Path) -> list[tuple[str, str]]:
    """What the tests recorded as their properties."""
    if not junit.exists():
        return []
    return [(str(p.get("name")), str(p.get("value"))) for p in ET.parse(junit).getroot().iter("property")]


def count(junit: Path) -> tuple[int, int]:
    """Tests that ran, and tests that were skipped."""
    if not junit.exists():
        return 0, 0
    suites = ET.parse(junit).getroot().iter("testsuite")
    tests = [(int(suite.get("tests", 0)), int(suite.get("skipped", 0))) for suite in suites]
    skipped = sum(skip for _, skip in tests)
    return sum(total for total, _ in tests) - skipped, skipped


def not_run(why_not_native: str, why_no_guest: str) -> int:
    announce("SocketCAN: NOT RUN, there is no vcan0 here")
    say(f"native: {why_not_native}\nUser Mode Linux: {why_no_guest}\nget it with: apt install {PACKAGES}")
    say("tests not run:")
    subprocess.run([*PYTEST, str(HERE), "--collect-only", "-q"], cwd=ROOT, check=False)
    return int(os.environ.get("REQUIRE_SOCKETCAN") == "1")


def announce(text: str) -> None:
    say(f"\n{'=' * 100}\n{text}\n{'=' * 100}")


def say(text: str) -> None:
    print(text, flush=True)  # noqa: T201 - a script talks to its terminal


if __name__ == "__main__":
    sys.exit(main())
