"""What the public functions return is public too."""

import dataclasses
import inspect
import typing

import xarray

import identifiability

PUBLIC = {name: getattr(identifiability, name) for name in identifiability.__all__}


def named(annotation):
    """Classes of this package in an annotation."""
    if isinstance(annotation, type) and annotation.__module__.startswith("identifiability."):
        yield annotation
    for part in typing.get_args(annotation):
        yield from named(part)


def hints(thing):
    # What is imported for type checkers alone: axes that views are handed, and public names.
    return typing.get_type_hints(thing, localns={"Axes": object, "xarray": xarray} | PUBLIC)


def given(thing):
    """Annotations of what a public function returns, or a public class has and returns."""
    if inspect.isfunction(thing):
        yield hints(thing).get("return")
    if not inspect.isclass(thing):
        return
    if dataclasses.is_dataclass(thing):
        fields = {f.name for f in dataclasses.fields(thing) if not f.name.startswith("_")}
        yield from (kind for name, kind in hints(thing).items() if name in fields)
    for name, _ in inspect.getmembers(thing):
        member = inspect.getattr_static(thing, name)
        member = member.fget if isinstance(member, property) else member
        if not name.startswith("_") and inspect.isfunction(member):
            yield hints(member).get("return")


def test_what_is_given_is_public():
    inner = {
        kind.__qualname__
        for thing in PUBLIC.values()
        for annotation in given(thing)
        for kind in named(annotation)
        if kind not in PUBLIC.values() and not kind.__name__.startswith("_")
    }
    assert inner == set()


def test_every_effect_is_public():
    from identifiability.joint.effects import EFFECTS

    assert {effect.__name__ for effect in EFFECTS.values()} <= set(identifiability.__all__)
