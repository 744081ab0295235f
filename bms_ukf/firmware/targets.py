"""The machines that firmware is made for, each with one ABI, and what their C compiler is called with."""

from __future__ import annotations

from typing import NamedTuple

from llvmlite import binding as llvm

llvm.initialize_all_targets()
llvm.initialize_all_asmprinters()


class Target(NamedTuple):
    """How LLVM and a C compiler name a machine."""

    triple: str
    cpu: str
    features: str
    abi: str
    abi_text: str  # for people
    gcc: str  # flags that the object must be linked with

    @property
    def kind(self) -> str:
        """LLVM's name of the instruction set: "thumb", "riscv32", "x86-64" and so on."""
        return str(llvm.Target.from_triple(self.triple).name)

    def machine(self) -> llvm.TargetMachine:
        """LLVM's code generator for it."""
        found = llvm.Target.from_triple(self.triple)
        relocation = "static" if self.gcc else "pic"  # firmware lies at a fixed place, a shared library anywhere
        return found.create_target_machine(self.cpu, self.features, 2, relocation, "small", abiname=self.abi)


TARGETS = {
    "cortex-m4": Target(
        "thumbv7em-none-unknown-eabihf",
        "cortex-m4",
        "",
        "",
        "AAPCS, hard float, fpv4-sp-d16",
        "-mcpu=cortex-m4 -mthumb -mfloat-abi=hard -mfpu=fpv4-sp-d16",
    ),
    "cortex-m7": Target(
        "thumbv7em-none-unknown-eabihf",
        "cortex-m7",
        "",
        "",
        "AAPCS, hard float, fpv5-d16",
        "-mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16",
    ),
    "rv32": Target(
        "riscv32-unknown-unknown-elf",
        "generic-rv32",
        "+m,+a,+f,+c",
        "ilp32f",
        "rv32imafc, ilp32f",
        "-march=rv32imafc -mabi=ilp32f",
    ),
    "aarch64-linux": Target("aarch64-unknown-linux-gnu", "generic", "", "", "AAPCS64, position independent", ""),
    "x86_64-linux": Target("x86_64-unknown-linux-gnu", "x86-64", "", "", "System V, position independent", ""),
    # Any processor of this machine's kind, with no vectors: what a test of the export compares with.
    "host": Target(llvm.get_default_triple(), "", "", "", f"{llvm.get_default_triple()}, position independent", ""),
}
