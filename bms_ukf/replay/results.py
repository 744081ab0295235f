"""A result in Parquet: the trace, and in the file's metadata the summary and the key of the job that made it.

A file with the key of a job is that job's result: it was written under another name and renamed when it was whole.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bms_ukf.errors import ConfigError
from bms_ukf.trace import Trace

if TYPE_CHECKING:
    from bms_ukf.replay.batch import Job

SUFFIX = ".parquet"
_KEY, _SUMMARY = b"bms_ukf.job", b"bms_ukf.summary"


def key(job: Job) -> str:
    """What the result of a job depends on: recording, cell, configuration, options and the version of this program."""
    from bms_ukf import __version__

    try:
        stats = [path.stat() for path in (job.recording, job.config) if path is not None]
    except OSError as error:
        raise ConfigError(job.recording, expected=f"a file that can be read ({error.strerror})") from None
    files = [(stat.st_size, stat.st_mtime_ns) for stat in stats]
    cells = [None if cell is None else cell.model_dump_json() for cell in (job.cell, job.other)]
    told = (__version__, str(job.recording), files, cells, job.options, job.tuning.model_dump_json())
    return hashlib.sha256(repr(told).encode()).hexdigest()


def kept(path: Path, job_key: str) -> dict[str, Any] | None:
    """The summary in a result at `path`, if there is one of this job."""
    parquet = _parquet()
    try:
        metadata = parquet.read_schema(path).metadata or {}
    except (OSError, ValueError):  # none yet, or something else by this name
        return None
    if metadata.get(_KEY, b"").decode() != job_key:
        return None
    found: dict[str, Any] = json.loads(metadata[_SUMMARY])
    return found


def write(path: Path, trace: Trace, summary: dict[str, Any], job_key: str) -> None:
    """Write trace and summary, whole or not at all. ConfigError if that is not possible."""
    parquet = _parquet()
    import pyarrow

    table = pyarrow.table({name: pyarrow.array(values) for name, values in trace.columns().items()})
    table = table.replace_schema_metadata({_KEY: job_key.encode(), _SUMMARY: json.dumps(summary).encode()})
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        parquet.write_table(table, partial, compression="zstd")
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise ConfigError(path, expected=f"a file that can be written ({error.strerror or error})") from None


def _parquet() -> Any:
    try:
        import pyarrow.parquet
    except ImportError:
        raise ConfigError("--format", value="parquet", expected="pip install 'bms-ukf[parquet]'") from None
    return pyarrow.parquet
