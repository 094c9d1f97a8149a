"""Names that a package offers and imports when they are first used.

So `import handlaser_gtsam` and `handlaser --help` answer at once. Such a package states its names in
imports that only type checkers follow. It has no `__all__`, so that `help` shows its own text and not
the text of all that it offers.
"""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from importlib.abc import InspectLoader


def lazy_names(package: str) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a package: it offers what it imports for type checkers.

    A name that is not offered, but by one of its modules, is answered by an AttributeError that says
    where it is.
    """
    loader = cast("InspectLoader", sys.modules[package].__loader__)
    homes = {
        alias.name: "." * node.level + (node.module or "")
        for block in ast.parse(loader.get_source(package) or "").body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }

    def get(name: str) -> object:
        home = homes.get(name, "")
        if home and home != ".":
            module = import_module(home, package)
            if name in dir(module):
                found: object = getattr(module, name)
                setattr(sys.modules[package], name, found)  # a second look is as fast as any name's
                return found
        if home:
            return import_module(f"{home.rstrip('.')}.{name}", package)
        message = f"module {package!r} has no attribute {name!r}"
        for module_name in () if name.startswith("_") else homes:
            if homes[module_name] == "." and name in dir(get(module_name)):
                message += f"; it is {package}.{module_name}.{name}"
                break
        raise AttributeError(message)

    return get, lambda: sorted(homes)
