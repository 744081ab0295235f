"""TOML reads back every name that a cell file takes from its manifest."""

from __future__ import annotations

import tomllib

from hypothesis import given
from hypothesis import strategies as st

from bms_ukf.identify import cellfile


@given(title=st.text(), name=st.text(), values=st.dictionaries(st.text(), st.text() | st.floats(-1e12, 1e12)))
def test_any_text_is_read_back_as_it_was(title: str, name: str, values: dict[str, str | float]) -> None:
    text = cellfile.to_toml({"cell": {"name": name}, "provenance.sha256": values}, title)
    read = tomllib.loads(text)
    assert read["cell"]["name"] == name
    found = read["provenance"]["sha256"]
    assert found.keys() == values.keys()
    for key, value in values.items():
        if isinstance(value, str):
            assert found[key] == value
        else:
            assert abs(found[key] - value) <= 1e-9 * abs(value) + 0.05 * (abs(value) > 1e9)
