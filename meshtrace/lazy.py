"""Import the names of a package when they are first used."""

from collections.abc import Callable
from typing import Any

import lazy_loader

from meshtrace.errors import did_you_mean


def attach(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package, read from its stub.

    Parameters
    ----------
    package : str
        Name of the package.
    file : str
        Its `__init__.py`; `__init__.pyi` beside it lists the names and where they are.

    Examples
    --------
    >>> import meshtrace.optics
    >>> meshtrace.optics.Petzol
    Traceback (most recent call last):
    AttributeError: module 'meshtrace.optics' has no attribute 'Petzol', did you mean Petzold?
    """
    import_attribute, list_names, names = lazy_loader.attach_stub(package, file)

    def attribute(name: str) -> Any:
        # looked up here: an AttributeError of the imported module itself passes unchanged
        if name not in names:
            # the import system, doctest and inspect ask for names of this form
            hint = "" if name.startswith("__") else did_you_mean(name, names)
            text = f"module {package!r} has no attribute {name!r}"
            raise AttributeError(", ".join(filter(None, (text, hint))))
        return import_attribute(name)

    return attribute, list_names, names
