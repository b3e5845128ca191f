"""What a result was computed from: the package's version, and fingerprints of values."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np


def package_version() -> str:
    """Version of this package, "0+unknown" if it is not installed."""
    try:
        return version("identifiability")
    except PackageNotFoundError:
        return "0+unknown"


def fingerprint(*parts: Any) -> str:
    """Hash of values that does not depend on process, machine or the order of keys.

    Parameters
    ----------
    *parts
        Dataclasses, mappings, sequences, numbers, texts or arrays.

    Returns
    -------
    str
        32 hexadecimal digits.
    """
    text = json.dumps(parts, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
        return {"class": type(value).__qualname__, **fields}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return {"dtype": value.dtype.str, "shape": value.shape, "sha256": digest}
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"cannot tell whether a {type(value).__name__} has changed; use plain values")
