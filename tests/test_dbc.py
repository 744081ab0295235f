"""DBC files read, and signals compiled, with cantools' own coding as the twin."""

from __future__ import annotations

import math
from pathlib import Path

import cantools
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bms_ukf.dbc import Field, Matrix, own_matrix, protection
from bms_ukf.errors import ConfigError

# Every kind of signal: both byte orders, aligned and not, signed and not, float, value tables, across 64 bytes or 5.
KINDS = """
VERSION ""
BU_: A
BO_ 100 Kinds: 8 A
 SG_ Intel : 3|13@1+ (0.5,-100) [-100|3994.5] "V" A
 SG_ IntelSigned : 16|12@1- (0.1,5) [-199|209] "A" A
 SG_ Motorola : 39|11@0+ (0.25,0) [0|511] "V" A
 SG_ MotorolaSigned : 44|10@0- (-2,1) [-1021|1023] "A" A
 SG_ Bit : 63|1@1+ (1,0) [0|1] "" A
BO_ 101 Short: 5 A
 SG_ Motorola : 2|19@0- (0.001,0) [-200|200] "A" A
 SG_ Intel : 24|16@1- (1,0) [-32766|32767] "A" A
BO_ 2147483749 Floats: 12 A
 SG_ Single : 0|32@1- (1,0) [0|0] "V" A
 SG_ Double : 39|64@0- (2,1) [0|0] "V" A
VAL_ 100 Intel 8191 "NotAvailable" 8190 "Error" ;
VAL_ 100 MotorolaSigned -512 "NotAvailable" ;
VAL_ 101 Intel -32768 "NotAvailable" -32767 "Error" ;
SIG_VALTYPE_ 101 Motorola : 0;
SIG_VALTYPE_ 2147483749 Single : 1;
SIG_VALTYPE_ 2147483749 Double : 2;
"""

SOUND = """
VERSION ""
BU_: A
BO_ 1 Sound: 8 A
 SG_ Current : 0|16@1- (0.1,0) [0|0] "A" A
"""
# Two signals on the same bits.
LENIENT = f"""{SOUND}
BO_ 2 Broken: 8 A
 SG_ Voltage : 0|16@1+ (0.1,0) [0|0] "V" A
 SG_ Other : 8|16@1+ (0.1,0) [0|0] "V" A
"""


@pytest.fixture(scope="module")
def kinds(tmp_path_factory: pytest.TempPathFactory) -> Matrix:
    path = tmp_path_factory.mktemp("dbc") / "kinds.dbc"
    path.write_text(KINDS)
    return Matrix([path])


SIGNALS = [
    *("Kinds.Intel", "Kinds.IntelSigned", "Kinds.Motorola", "Kinds.MotorolaSigned", "Kinds.Bit"),
    *("Short.Motorola", "Short.Intel", "Floats.Single", "Floats.Double"),
]


@pytest.mark.parametrize("name", SIGNALS)
@given(data=st.data())
def test_extract_equals_cantools(kinds: Matrix, name: str, data: st.DataObject) -> None:
    message, signal = kinds.find(name)
    payload = data.draw(st.binary(min_size=message.length, max_size=message.length))
    theirs = message.decode(payload)[signal.name]
    ours = Field(message, signal).extract()(payload)
    if isinstance(theirs, float | int) and math.isfinite(theirs):
        assert ours == pytest.approx(theirs, rel=1e-15, abs=1e-15)
    else:
        assert math.isnan(ours), "a word of the value table, or no number"


def test_a_double_that_its_scale_makes_infinite_is_no_number(kinds: Matrix) -> None:
    message, signal = kinds.find("Floats.Double")
    largest = bytes.fromhex("000000007fe0000000000000")[: message.length]
    assert message.decode(largest)[signal.name] == math.inf
    assert math.isnan(Field(message, signal).extract()(largest))


@pytest.mark.parametrize("name", ["Kinds.Intel", "Kinds.MotorolaSigned", "Short.Intel"])
@given(data=st.data())
def test_insert_equals_cantools(kinds: Matrix, name: str, data: st.DataObject) -> None:
    message, signal = kinds.find(name)
    assert signal.minimum is not None
    assert signal.maximum is not None
    value = data.draw(st.floats(float(signal.minimum), float(signal.maximum)))
    field = Field(message, signal)
    ours = field.insert()(value).to_bytes(message.length, field.order)
    others = {other.name: other.offset for other in message.signals}
    theirs = message.encode(others | {signal.name: value}, strict=False)
    assert field.raw()(ours) == field.raw()(theirs)
    assert field.extract()(ours) == pytest.approx(value, abs=abs(field.scale) * 0.5000001)


@pytest.mark.parametrize(
    ("value", "sent"), [(math.nan, 8191), (math.inf, 8189), (-math.inf, 0), (1e300, 8189), (-1e300, 0), (0.0, 200)]
)
def test_insert_clamps_and_never_wraps(kinds: Matrix, value: float, sent: int) -> None:
    """Kinds.Intel has limits up to 3994.5, raw 8189."""
    field = Field(*kinds.find("Kinds.Intel"))
    assert field.insert()(value) >> field.shift == sent


def test_insert_clamps_with_a_negative_scale(kinds: Matrix) -> None:
    field = Field(*kinds.find("Kinds.MotorolaSigned"))
    message, _ = kinds.find("Kinds.MotorolaSigned")
    sent = [field.extract()(field.insert()(value).to_bytes(message.length, "big")) for value in (9999.0, -9999.0)]
    assert sent == [1023.0, -1021.0]


@given(value=st.floats(-100, 100))
def test_factor_of_insert_undoes_that_of_extract(value: float) -> None:
    field = Field(*own_matrix().find("PackMeasurement.PackCurrent"))
    payload = field.insert(-1.0)(value).to_bytes(8, "little")
    assert field.extract(-1.0)(payload) == pytest.approx(value, abs=0.00051)
    assert field.extract()(payload) == pytest.approx(-value, abs=0.00051)


@settings(max_examples=300)
@given(payload=st.binary(min_size=8, max_size=8))
def test_every_signal_of_our_matrix_is_read_as_cantools_reads_it(payload: bytes) -> None:
    for message in (
        own_matrix().message(name) for name in ("PackMeasurement", "SocEstimate", "SocQuality", "BmsState")
    ):
        for name, theirs in message.decode(payload, decode_choices=False).items():
            field = Field(message, message.get_signal_by_name(name))
            field.codes = frozenset()
            assert field.extract()(payload) == pytest.approx(theirs, rel=1e-14)


def test_a_signal_that_cannot_say_not_available_is_not_sent(kinds: Matrix) -> None:
    with pytest.raises(ValueError, match="not available"):
        Field(*kinds.find("Kinds.Motorola")).insert()


def test_an_unknown_protection_is_refused_and_not_ignored(tmp_path: Path) -> None:
    attributes = 'BA_DEF_ BO_ "E2EProfile" STRING ;\nBA_DEF_DEF_ "E2EProfile" "none";\nBA_ "E2EProfile" BO_ 1 "P02";\n'
    (tmp_path / "other.dbc").write_text(SOUND + attributes)
    with pytest.raises(ConfigError, match=r"Sound: E2EProfile is 'P02'"):
        protection(Matrix([tmp_path / "other.dbc"]).message("Sound"))


def test_codes_beyond_the_value_table_are_not_numbers(kinds: Matrix) -> None:
    field = Field(*kinds.find("Kinds.IntelSigned"), not_available=[-1])
    payload = (0xFFF << 16).to_bytes(8, "little")
    assert math.isnan(field.extract()(payload))


def one_line(caught: pytest.ExceptionInfo[ConfigError]) -> str:
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_a_misspelt_signal_is_answered_with_the_nearest_names(kinds: Matrix) -> None:
    with pytest.raises(ConfigError) as caught:
        kinds.find("Kinds.Inteel", source="mine.toml", key="signals.current")
    assert one_line(caught).startswith("mine.toml: signals.current is 'Kinds.Inteel'; expected a signal of Kinds")
    assert "Kinds.Intel" in str(caught.value)


def test_a_misspelt_message_is_answered_with_the_nearest_names(kinds: Matrix) -> None:
    with pytest.raises(ConfigError, match="Kinds") as caught:
        kinds.find("Kind.Intel")
    one_line(caught)


def test_a_message_in_two_files_is_refused(tmp_path: Path) -> None:
    for name in ("a.dbc", "b.dbc"):
        (tmp_path / name).write_text(KINDS)
    with pytest.raises(ConfigError, match="one message"):
        Matrix([tmp_path / "a.dbc", tmp_path / "b.dbc"]).find("Kinds.Intel")


@pytest.mark.parametrize("content", [b"", b"not a dbc\n", b"\xff\xfe\x00\x81\n", b"BO_ 1 M: 8 A\n SG_ S : 0|70@1+"])
def test_an_unreadable_file_gives_one_line(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "bad.dbc"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        Matrix([path], strict=False).find("M.S")
    assert "bad.dbc" in one_line(caught)


def test_a_missing_file_gives_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.dbc"):
        Matrix([tmp_path / "none.dbc"], strict=False)


def test_our_own_kind_of_reading_is_strict(tmp_path: Path) -> None:
    (tmp_path / "lenient.dbc").write_text(LENIENT)
    with pytest.raises(ConfigError, match="overlapping"):
        Matrix([tmp_path / "lenient.dbc"])


def test_lenient_reading_warns_and_refuses_only_the_broken_message(tmp_path: Path) -> None:
    (tmp_path / "lenient.dbc").write_text(LENIENT)
    matrix = Matrix([tmp_path / "lenient.dbc"], strict=False)
    assert len(matrix.warnings) == 1
    assert "lenient.dbc" in matrix.warnings[0]
    assert matrix.find("Sound.Current")[1].name == "Current"
    with pytest.raises(ConfigError, match="overlapping"):
        matrix.find("Broken.Voltage")


def test_cantools_reads_our_matrix_strictly() -> None:
    assert cantools.database.load_file(Path(__file__).parents[1] / "can" / "bms.dbc", strict=True)
