"""What a CONFIG says of the end-to-end protection of a vehicle's messages: `[signals.e2e.Message]`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bms_ukf import e2e, toml
from bms_ukf.dbc import Field as DbcField
from bms_ukf.dbc import Matrix
from bms_ukf.errors import ConfigError

Number = Annotated[int, Field(ge=0, lt=1 << 32)]
Byte = Annotated[int, Field(ge=0, lt=256)]
Place = Annotated[int, Field(ge=0, lt=64)]


class Crc(toml.Section):
    """crc: the parameters catalogues give, and where it stands."""

    width: Literal[8, 16, 32] = 8
    polynomial: Number
    initial: Number = 0
    xor_out: Number = 0
    reflect: bool = False  # input and output
    byte: Place  # of the payload, where the CRC begins
    byte_order: Literal["little", "big"] = "little"  # of a CRC of several bytes
    covers: Annotated[list[Place], Field(min_length=2, max_length=2)] | None = None  # first, last; None: all others

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if max(self.polynomial, self.initial, self.xor_out) >= 1 << self.width:
            raise ValueError(f"polynomial, initial and xor_out of {self.width} bits")
        return self


class E2e(toml.Section):
    """[signals.e2e.Message]: an AUTOSAR profile by name, or a CRC and a counter of the vehicle's own."""

    profile: e2e.PresetName | None = None
    data_id: list[Annotated[int, Field(ge=0, lt=1 << 16)]] = Field(default_factory=list)  # bytes where it is no profile
    data_id_at: Literal["before", "after"] = "before"  # the bytes that `crc` covers
    crc: Crc | None = None
    counter: Annotated[str, Field(min_length=1)] | None = None  # the signal of that message
    counter_values: Annotated[int, Field(ge=2)] | None = None  # 0 to one less; None: all that its bits can say
    max_delta: Annotated[int, Field(ge=1)] | None = None  # how far ahead is not a rewound counter; None: half the range
    timeout_s: Annotated[float, Field(gt=0)] = 0.5  # without an accepted frame for longer, the old counter says nothing

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        own = self.crc is not None or self.counter is not None
        if own == (self.profile is not None):
            raise ValueError("either profile, or crc, counter or both")
        if self.counter is None and self.counter_values is not None:
            raise ValueError("counter_values with counter only")
        return self

    def made(self, message: str, matrix: Matrix, source: str | Path) -> e2e.Profile:
        """The protection of `message`. ConfigError if it does not fit the message."""
        key = f"signals.e2e.{message}"
        found = matrix.message(message, source=source, key="signals.e2e")
        if self.profile is not None:
            try:
                profile = e2e.preset(self.profile, self.data_id)
            except ValueError as error:
                expected = f"{error} with {self.profile}"
                raise ConfigError(source, key=f"{key}.data_id", value=self.data_id, expected=expected) from None
            length = 1 + (profile.crc.width // 8 if profile.crc is not None else 0)
            if found.length <= length:
                expected = f"a message longer than {length} bytes with {self.profile}"
                raise ConfigError(source, key=key, value=message, expected=expected)
        else:
            profile = self._own(key, message, matrix, source)
        wanted = self.max_delta or max(profile.modulo // 2, 1)
        if wanted >= max(profile.modulo, 2):
            raise ConfigError(source, key=f"{key}.max_delta", value=wanted, expected=f"below {profile.modulo}")
        return replace(profile, max_delta=wanted, timeout_ns=round(self.timeout_s * 1e9))

    def _own(self, key: str, message: str, matrix: Matrix, source: str | Path) -> e2e.Profile:
        count, modulo = None, 1
        if self.counter is not None:
            found, signal = matrix.find(f"{message}.{self.counter}", source=source, key=f"{key}.counter")
            field = DbcField(found, signal)
            count, modulo = field.raw(), self.counter_values or field.mask + 1
            if modulo > field.mask + 1:
                expected = f"at most {field.mask + 1}, for the bits of {self.counter}"
                raise ConfigError(source, key=f"{key}.counter_values", value=modulo, expected=expected)
        if self.crc is None:
            return e2e.Profile(counter=count, modulo=modulo)
        length, crc = matrix.message(message, source=source).length, self.crc
        last = max(crc.byte + crc.width // 8 - 1, *(crc.covers or [0]))
        if last >= length:
            expected = f"bytes within the {length} of {message}"
            raise ConfigError(source, key=f"{key}.crc", value=last, expected=expected)
        if any(byte > 0xFF for byte in self.data_id):
            raise ConfigError(source, key=f"{key}.data_id", value=self.data_id, expected="bytes, 0 to 255")
        data_id, nothing = (bytes(self.data_id),), (b"",)
        return e2e.Profile(
            e2e.Crc(crc.width, crc.polynomial, crc.initial, crc.xor_out, crc.reflect),
            crc_byte=crc.byte,
            crc_order=crc.byte_order,
            covers=None if crc.covers is None else (crc.covers[0], crc.covers[1]),
            before=data_id if self.data_id_at == "before" else nothing,
            after=data_id if self.data_id_at == "after" else nothing,
            counter=count,
            modulo=modulo,
        )
