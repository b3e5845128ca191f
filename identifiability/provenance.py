"""What a result was computed from: the package's version and code, and fingerprints of values."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import re
import sys
from collections.abc import Iterator, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from identifiability.errors import InputError

PACKAGE = Path(__file__).resolve().parent
_SHOWN = 12  # digits of a fingerprint that people are shown

# Also found in the text of a docstring, where it does no harm.
_IMPORT = re.compile(
    r"^\s*from\s+([\w.]+)\s+import\s+(\([^)]*\)|.*)|^\s*import\s+(.+)", re.MULTILINE
)


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


# The code


@functools.cache
def code_fingerprint(*modules: str, package: Path = PACKAGE) -> str:
    """Hash of the sources that some modules run.

    These are the modules' own files and those of everything in this package that they import, at
    whatever remove; so a change of the command line or of a page does not touch the fingerprint of
    a computation, and any change of a file that takes part does, be it one of a comment. It is
    computed once in a process.

    Parameters
    ----------
    *modules : str
        Names of modules, of this package or not. None: the whole package.
    package : Path
        Folder of the package's sources.

    Returns
    -------
    str
        32 hexadecimal digits; the same wherever the package is installed.

    Raises
    ------
    InputError
        For a module that is not there.
    """
    digest = hashlib.sha256()
    for name, path in sorted(_sources(modules or (package.name,), package).items()):
        digest.update(f"{name}\n".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:32]


def _sources(modules: tuple[str, ...], package: Path) -> dict[str, Path]:
    """Files of modules and of all that they import, by module; other packages are left out."""
    found: dict[str, Path] = {}
    ahead = list(modules)
    while ahead:
        name = ahead.pop()
        if name in found:
            continue
        if name == package.name:
            # The root gives every public name, whatever is asked of it.
            found |= {_name(path, package): path for path in package.rglob("*.py")}
            continue
        path = _file(name, package)
        if path is None:
            raise InputError(
                f"found no source of the module '{name}', expected one of {package.name}, or one "
                "that was imported from a file"
            )
        found[name] = path
        if _file(parent := name.rpartition(".")[0], package) and parent != package.name:
            ahead.append(parent)
        ahead += _imported(path.read_text(encoding="utf-8"), package)
    return found


def _imported(source: str, package: Path) -> Iterator[str]:
    """Modules of the package that a source imports; the root, where it imports a public name."""
    for parent, names, plain in _IMPORT.findall(source):
        for module in [parent] if parent else re.findall(r"[\w.]+", plain):
            if module.split(".")[0] != package.name:
                continue
            inner = [
                f"{module}.{name}"
                for name in re.findall(r"\w+", names)
                if _file(f"{module}.{name}", package)
            ]
            # Of the root's own names none but its modules say what they are made of.
            if module != package.name or not inner:
                yield module
            yield from inner


def _file(module: str, package: Path) -> Path | None:
    """Source of a module: of the package by its place, of others if they are imported."""
    first, *rest = module.split(".")
    if first == package.name:
        path = package.joinpath(*rest)
        options = (
            [path.with_suffix(".py"), path / "__init__.py"] if rest else [path / "__init__.py"]
        )
        return next((option for option in options if option.is_file()), None)
    file = getattr(sys.modules.get(module), "__file__", None)
    return Path(file) if file and Path(file).is_file() else None


def _name(path: Path, package: Path) -> str:
    parts = path.relative_to(package.parent).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


# Records


class Stored(NamedTuple):
    """A record that was read.

    Attributes
    ----------
    record : dict
    remark : str
        That other code made it, in one sentence; empty if the code is this one's.
    """

    record: dict[str, Any]
    remark: str


def stamp(*modules: str) -> dict[str, str]:
    """What a record says of the code that made it: version, modules, and their fingerprint.

    Parameters
    ----------
    *modules : str
        Which, with all that they import, made the record.
    """
    return {
        "package": package_version(),
        "code": code_fingerprint(*modules),
        "code_of": " ".join(modules),
    }


def made_by(record: Mapping[str, Any]) -> str:
    """Version and fingerprint that a record states, for its page."""
    code = record.get("code")
    return f"version {record['package']}" + (f", code {code[:_SHOWN]}" if code else "")


def remark(record: Mapping[str, Any]) -> str:
    """Say that other code than this made a record; empty if this one did.

    Parameters
    ----------
    record : mapping
        With the keys of `stamp`; the attributes of a data set, too.
    """
    code = record.get("code")
    if not code:
        return "made by other code (it states no fingerprint)"
    try:
        # Modules may have gone since.
        ours = code_fingerprint(*record["code_of"].split())
    except InputError:
        ours = ""
    if ours == code:
        return ""
    return f"made by other code (fingerprint {code[:_SHOWN]}, now {ours[:_SHOWN] or 'gone'})"


def read_record(path: Path) -> Stored:
    """Read a record from its JSON file, and whether other code than this made it.

    Raises
    ------
    InputError
        Where there is no file or it is not a record.
    """
    try:
        record = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"cannot read '{path}' ({error.strerror}); give the path of a record, a .json file"
        ) from None
    except ValueError as error:
        raise InputError(f"'{path}' is not valid JSON ({error}); have it written again") from None
    if not isinstance(record, dict) or "package" not in record:
        raise InputError(f"'{path}' does not say what made it, so it is no record of this package")
    return Stored(record, remark(record))
