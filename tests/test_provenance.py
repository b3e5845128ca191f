"""Fingerprints tell computations apart, whatever process or machine they are made on."""

from dataclasses import dataclass

import numpy as np
import pytest

from identifiability.provenance import fingerprint


@dataclass(frozen=True)
class Setting:
    number: int
    note: str = ""


def test_fingerprints_tell_configurations_apart():
    values = [
        Setting(1),
        Setting(2),
        Setting(1, note="x"),
        {"a": 1, "b": 2.0},
        {"a": 1, "b": 2.0000000001},
        [1, 2],
        [2, 1],
        np.arange(3.0),
        np.arange(3.0)[::-1],
        np.arange(3),
        None,
    ]
    assert len({fingerprint(value) for value in values}) == len(values)
    assert fingerprint({"a": 1, "b": 2}) == fingerprint({"b": 2, "a": 1})
    assert fingerprint(np.float64(0.1)) == fingerprint(0.1)
    # Written down, because results on disk are found by it.
    assert fingerprint("a", 1, 0.1) == "84c79b69ebcae7df28e2d0c577dd8270"


def test_what_has_no_fingerprint_is_refused():
    with pytest.raises(TypeError, match="plain values"):
        fingerprint(object())
