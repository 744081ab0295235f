"""What an exported estimator costs: flash, RAM, stack, and what it leaves to the linker."""

from __future__ import annotations

from typing import NamedTuple

from bms_ukf.firmware import elf, stack
from bms_ukf.firmware.compile import Compiled
from bms_ukf.firmware.targets import Target
from bms_ukf.kernel import layout
from bms_ukf.kernel.embedded import HEADER, size
from bms_ukf.kernel.layout import Form


class Cost(NamedTuple):
    """In bytes. `stack` is that of `bms_ukf_step` without libm's, None where frames are not read (host)."""

    code: int
    tables: int
    ram_cell: int
    ram_shared: int  # the header of the state, and the workspace
    ram: int
    stack: int | None
    undefined: list[str]

    @property
    def flash(self) -> int:
        return self.code + self.tables


def cost(compiled: Compiled, form: Form, cells: int, bits: int, target: Target) -> Cost:
    sections = elf.flash(compiled.object)
    tables = sum(size for name, size in sections.items() if name.startswith(".rodata"))
    frames = stack.frames(compiled.assembly, target.kind)
    number = bits // 8
    return Cost(
        code=sum(sections.values()) - tables,
        tables=tables,
        ram_cell=number * (form.size + layout.IO_ROWS + form.parts),
        ram_shared=number * (HEADER + compiled.work),
        ram=number * (size(form, cells) + compiled.work),
        stack=None if frames is None else stack.worst(frames, "bms_ukf_step"),
        undefined=elf.undefined(compiled.object),
    )
