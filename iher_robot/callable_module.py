"""Lets `iher_robot.train` be both the module and the function of that name.

Importing the module ``iher_robot.train`` makes Python bind the package's attribute ``train`` to
the module, whatever the package had bound to that name. Changing the class of a module object is
the documented way to give it behaviour, so both ``iher_robot.train(...)`` and
``from iher_robot.train import train`` work, in any order.
"""

from __future__ import annotations

import sys
from types import ModuleType


class CallableModule(ModuleType):
    """A module whose call is a call of the function that bears its name."""

    def __call__(self, *args: object, **kwargs: object) -> object:
        """Call the function of the module's own name."""
        function = getattr(self, self.__name__.rpartition(".")[2])
        return function(*args, **kwargs)


def make_module_callable(name: str) -> None:
    """Make an imported module callable; the last line of that module.

    Args:
        name: The module's ``__name__``; the module has a function of the same last name.
    """
    sys.modules[name].__class__ = CallableModule
