"""Laws from a user's own file: ``my_file.MyLaw`` or ``my_file.py:MyLaw``."""

import importlib.util
import inspect
import os
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np

from tarc.core import validation as check
from tarc.core.errors import InvalidParameter, UnsupportedLaw
from tarc.core.symbol_errors import place_of
from tarc.core.tracing import trace
from tarc.core.trees import pack
from tarc.laws.base import Law
from tarc.plants.mujoco import MujocoPlant

MODULE_PREFIX = "tarc_user_"
"""How the modules of users' files are named."""

TRIAL_ERROR = 0.01
"""Error of each joint in the trial of a law [rad or m]."""


def is_user_law(kind: object) -> bool:
    """Return whether the kind of a law names a class in a file."""
    return isinstance(kind, str) and ("." in kind or ":" in kind)


def split_kind(kind: str) -> tuple[Path, str]:
    """Return file and class of ``my_file.MyLaw`` or ``my_file.py:MyLaw``.

    Raises
    ------
    InvalidParameter
        For a text of another form.
    """
    file, colon, name = kind.rpartition(":") if ".py:" in kind else kind.rpartition(".")
    if not colon or not file or not name.isidentifier():
        raise InvalidParameter(f"kind: got {kind!r}; needs my_file.MyLaw or my_file.py:MyLaw", "kind")
    return Path(file).expanduser() if ".py:" in kind else Path(f"{file.replace('.', '/')}.py"), name


def law_name(kind: str) -> str:
    """Return the name of the class alone."""
    return split_kind(kind)[1] if is_user_law(kind) else kind


def absolute_kind(kind: str, folder: Path) -> str:
    """Return the kind with the absolute path of its file, sought in a folder."""
    file, name = split_kind(kind)
    return f"{(folder / file).resolve()}:{name}"


def relative_kind(kind: str, folder: Path) -> str:
    """Return the kind with the path of its file from a folder: the reverse of `absolute_kind`."""
    file, name = split_kind(kind)
    return f"{Path(os.path.relpath(file, folder.resolve())).as_posix()}:{name}" if file.is_absolute() else kind


def kind_of(law: Law) -> str:
    """Return the kind of a law in a scenario: its class, with its file for one from a user's own file."""
    kind = type(law)
    module = sys.modules[kind.__module__]
    return f"{module.__file__}:{kind.__name__}" if is_from_file(law) else kind.__name__


def is_from_file(law: Law) -> bool:
    """Return whether a law is from a user's own file."""
    return type(law).__module__.startswith(MODULE_PREFIX)


def load_law(kind: str, path: str = "law.kind") -> type[Law]:
    """Return the class of a law from its file.

    Parameters
    ----------
    kind
        ``my_file.MyLaw`` or ``my_file.py:MyLaw``; a relative file is sought in the working directory.
    path
        Place in the scenario, for the messages.

    Raises
    ------
    InvalidParameter
        For a file that is missing or fails, and a name that is no complete law.
    """
    file, name = split_kind(kind)
    file = file.resolve()
    if not file.is_file():
        raise InvalidParameter(f"{path}: no file {file}; needs my_file.py:MyLaw, beside the scenario", path)
    module = _module(file, file.stat().st_mtime_ns, path)
    classes = {
        key: value
        for key, value in vars(module).items()
        if inspect.isclass(value) and issubclass(value, Law) and value.__module__ == module.__name__
    }
    law = vars(module).get(name)
    if law is None:
        present = f"its laws are {', '.join(classes)}" if classes else "it has no law"
        raise InvalidParameter(
            f"{path}: {file.name} has no {name}; {present}.{check.did_you_mean(name, classes)}", path
        )
    if not inspect.isclass(law) or not issubclass(law, Law):
        raise InvalidParameter(
            f"{path}: {name} in {file.name} is no law; needs a class that extends one of tarc.laws, such as TDE", path
        )
    if inspect.isabstract(law):
        raise InvalidParameter(
            f"{path}: {name} in {file.name} lacks {', '.join(sorted(law.__abstractmethods__))}", path
        )
    if vars(law).get("__annotations__") and "__dataclass_fields__" not in vars(law):
        raise InvalidParameter(
            f"{path}: {name} in {file.name} has parameters but is no dataclass; put "
            "@dataclass(frozen=True, kw_only=True, eq=False) before it",
            path,
        )
    return law


@cache
def _module(file: Path, changed: int, path: str) -> ModuleType:
    """Return the module of a file; it is run once, and again when it has changed."""
    name = f"{MODULE_PREFIX}{file.stem}_{abs(hash((file, changed)))}"
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise InvalidParameter(f"{path}: {file} is no Python file; needs my_file.py", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses look for the types of parameters
    sys.path.insert(0, str(file.parent))
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever a user's file may raise
        del sys.modules[name]
        raise InvalidParameter(
            f"{path}: {file.name} fails with {type(error).__name__}: {error} ({place_of(error)})", path
        ) from error
    finally:
        sys.path.remove(str(file.parent))
    return module


def check_user_law(law: Law, path: str) -> None:
    """Run a law once with numbers and once with symbols, and compare both.

    Raises
    ------
    InvalidParameter
        For an equation that fails, and one that gives another torque for symbols.
    UnsupportedLaw
        For an equation that decides by the value of a symbol, with what to write instead.
    """
    name = type(law).__name__
    if isinstance(getattr(law, "model", None), MujocoPlant):
        return  # called by CasADi, not traced
    state, value = law.example()
    value = value._replace(position=value.position + TRIAL_ERROR)
    try:
        results = law.step(state, value)
        function, _ = trace(law.step, state, value)
    except (InvalidParameter, UnsupportedLaw):
        raise
    except Exception as error:  # whatever a user's equation may raise
        raise InvalidParameter(
            f"{path}: {name} fails with {type(error).__name__}: {error} ({place_of(error)})", path
        ) from error
    torque = results[1].torque
    if np.shape(torque) != (law.n_joints,):
        raise InvalidParameter(f"{path}: {name} gives a torque {np.shape(torque)}; needs ({law.n_joints},)", path)
    for numbers, traced in zip(map(pack, results), function(pack(state), pack(value)), strict=True):
        if not np.allclose(numbers, np.array(traced)[:, 0], rtol=1e-6, atol=1e-9, equal_nan=True):
            raise InvalidParameter(
                f"{path}: {name} gives other results for symbols than for numbers, perhaps by a function of `math`, by "
                "float() or by a state outside its NamedTuple; use sin, exp, tanh and so on of tarc.core.array_ops",
                path,
            )
