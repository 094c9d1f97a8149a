"""What the public names take and return, found by walking their annotations."""

import dataclasses
import inspect
import typing
from collections.abc import Callable, Iterator

import gtsam
import polars

import handlaser_gtsam as hl

WHOLE_MODULES = {"scenes", "simulate", "starts"}
"""Public modules that define what they offer, in place of names of one subject."""


def is_inside(kind: type) -> bool:
    """Tell of what evaluations share and blocks are made of: its users import it from there."""
    module = kind.__module__
    return ".factors." in module or module.endswith(
        ("model.block", "model.range_blocks", "estimation.dense")
    )


def offered() -> dict[str, object]:
    """Return everything that has a public name, by that name: at the top and in modules."""
    things = {name: getattr(hl, name) for name in dir(hl)}
    modules = {name: thing for name, thing in things.items() if inspect.ismodule(thing)}
    for name, module in modules.items():
        if name not in WHOLE_MODULES:
            names = getattr(module, "__all__", None) or dir(module)
            things |= {one: getattr(module, one) for one in names}
    return {name: thing for name, thing in things.items() if name not in modules}


LATE = {"gtsam": gtsam, "pl": polars, "Drawing": object}  # the last is of matplotlib, an extra
LATE |= offered()
"""Names that modules import for type checkers only."""

INSIDE = {"Session.state"}
INSIDE |= {f"{name}.described" for name in ("Result", "Calibration", "SurveyCalibration")}
"""Views of the inside, documented as such: their classes may change and have no public name."""


def named(hint: object) -> Iterator[type]:
    """Yield the classes of this package inside an annotation."""
    if isinstance(hint, type) and hint.__module__.startswith("handlaser_gtsam"):
        yield hint
    for inner in typing.get_args(hint):
        for one in inner if isinstance(inner, list) else [inner]:  # the arguments of a Callable
            yield from named(one)


def callables(thing: object) -> Iterator[Callable[..., object]]:
    """Yield a function itself, or the public methods and properties of a class."""
    if inspect.isfunction(thing):
        yield thing
    if inspect.isclass(thing):
        for name, member in vars(thing).items():
            inner = getattr(member, "fget", None) or getattr(member, "__func__", member)
            public = name == "__init__" or not name.startswith("_")
            if inspect.isfunction(inner) and public and inner.__qualname__ not in INSIDE:
                yield inner


def hints_of(thing: object) -> list[object]:
    """Return the annotations of one public name, without those of private fields."""
    hints = [typing.get_type_hints(one, None, LATE) for one in callables(thing)]
    if dataclasses.is_dataclass(thing):
        hints.append(typing.get_type_hints(thing, None, LATE))
    named_hints = [pair for one in hints for pair in one.items()]
    return [hint for name, hint in named_hints if not name.startswith("_")]


def _home(thing: object) -> str:
    return str(getattr(thing, "__module__", ""))


def reachable() -> set[type]:
    """Return every class that the public names take or return, and those inside them."""
    found: set[type] = set()
    bare = (
        "handlaser_gtsam.factors.",
        "handlaser_gtsam.model.equation",
    )  # mathematics on bare arrays
    waiting = [thing for thing in offered().values() if not _home(thing).startswith(bare)]
    while waiting:
        hints = hints_of(waiting.pop())
        new = {kind for hint in hints for kind in named(hint)} - found
        found |= new
        waiting += new
    return found
