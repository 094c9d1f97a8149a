"""Names that a package offers and imports when they are first used.

So `import handlaser_gtsam` and `handlaser --help` answer at once. Such a package states every name
twice: in imports that type checkers read, and with its home for `lazy_names`. It has no `__all__`, so
that `help` shows its own text instead of the text of all that it offers.
"""

from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_names(
    package: str, homes: Mapping[str, str], modules: Mapping[str, str] | None = None
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a package.

    Parameters
    ----------
    package : str
        Its full name.
    homes : mapping of str to str
        The names that every module defines, separated by blanks; modules are relative to the package,
        with a dot in front to the one above it.
    modules : mapping of str to str, optional
        Modules that are offered themselves: name to relative home. A name that is not offered, but by
        one of these, is answered by an AttributeError that says where it is.
    """
    home_of = {name: f".{home}" for home, names in homes.items() for name in names.split()}
    module_of = {name: f".{home}" for name, home in (modules or {}).items()}

    def get(name: str) -> object:
        if name in home_of:
            return getattr(import_module(home_of[name], package), name)
        if name in module_of:
            return import_module(module_of[name], package)
        message = f"module {package!r} has no attribute {name!r}"
        if not name.startswith("_"):
            for module, home in module_of.items():
                if name in dir(import_module(home, package)):
                    message += f"; it is {package}.{module}.{name}"
                    break
        raise AttributeError(message)

    return get, lambda: sorted([*home_of, *module_of])
