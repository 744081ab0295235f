"""How much stack compiled functions take, read off their assembly.

Frames are of fixed size: a function pushes registers and lowers the stack pointer, by numbers that stand in its code.
All of them are added up, as if every one were met on every way through; so are the functions that LLVM has moved out of
others. What libm's functions take comes on top. An instruction that is not understood is an error, not a guess.
"""

from __future__ import annotations

import re

_BODY = re.compile(r"^(\w+):(.*?)^\.Lfunc_end\d+:", re.DOTALL | re.MULTILINE)
_ARM = re.compile(r"^\t(push|vpush|sub|str|stmdb|strd)(?:\.w)?\t(.*)$", re.MULTILINE)
_RISCV = re.compile(r"^\t(addi|c\.addi|sub|add)\tsp, (\w+), (\S+)$", re.MULTILINE)


def frames(assembly: str, kind: str) -> dict[str, int] | None:
    """Bytes by function; `kind` is "thumb" or "riscv32", and None comes back for any other."""
    measure = {"thumb": _thumb, "riscv32": _riscv}.get(kind)
    if measure is None:
        return None
    return {name: measure(name, body) for name, body in _BODY.findall(assembly)}


def worst(frames: dict[str, int], function: str) -> int:
    """Of a function that may call all those moved out of it, one from another."""
    return frames[function] + sum(size for name, size in frames.items() if name.startswith("OUTLINED_"))


def _thumb(name: str, body: str) -> int:
    total = 0
    for instruction, operands in _ARM.findall(body):
        if instruction in {"push", "vpush"}:
            total += (8 if instruction == "vpush" else 4) * _registers(operands)
        elif found := re.fullmatch(r"sp, (?:sp, )?#(\d+)|.*\[sp, #-(\d+)\]!", operands):
            total += int(found[1] or found[2])
        elif re.match(r"sp[,!]", operands):
            raise ValueError(f"{name}: {instruction} {operands} changes the stack pointer by what is not known")
    return total


def _registers(operands: str) -> int:
    count = 0
    for part in operands.strip("{}").split(","):
        first, _, last = part.strip().partition("-")
        count += int(last[1:]) - int(first[1:]) + 1 if last else 1
    return count


def _riscv(name: str, body: str) -> int:
    total = 0
    for instruction, base, amount in _RISCV.findall(body):
        if base != "sp" or not re.fullmatch(r"-?\d+", amount):
            raise ValueError(
                f"{name}: {instruction} sp, {base}, {amount} changes the stack pointer by what is not known"
            )
        total += max(0, -int(amount))
    return total
