"""Digest of a kernel and of everything that it can reach, by which its machine code is kept.

Read are bytecode, constants, options, default values, and what the names in the code stand for:
kernels, intrinsics, functions, and the values that Numba freezes. A name counts wherever it stands,
also as an attribute of something else: a kernel may be compiled again without need, never kept
without right. Comments, annotations, docstrings and lines are not read; a traceback may show the
line on which a kernel stood when it was compiled.

Not seen is what `numba.extending.overload` and its like register. A value is read once: whoever
changes a module's constants later changes no kernel.
"""

import enum
import hashlib
import sys
from dis import hasconst
from functools import cache
from types import BuiltinFunctionType, CodeType, FunctionType, GenericAlias, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import sigutils, types
from numba.core.extending import _Intrinsic
from numba.extending import is_jitted

#: Packages that are described by their versions: nothing in them is read.
_SEALED = {"builtins", "cmath", "collections", "contextlib", "enum", "functools", "itertools"}
_SEALED |= {"llvmlite", "math", "numba", "numpy", "operator", "types", "typing"}
#: Settings of Numba that change machine code; its key of a signature has the processor.
_SETTINGS = (
    "BOUNDSCHECK",
    "DEBUGINFO_DEFAULT",
    "LOOP_VECTORIZE",
    "OPT",
    "SLP_VECTORIZE",
    "USING_SVML",
)
#: Values whose `repr` tells all.
_PLAIN = (bool, int, float, complex, str, bytes, range, type(None), type(...))
#: Values that are described by their names, if they are of a package above.
_NAMED = (BuiltinFunctionType, GenericAlias, np.ufunc, type(np.sum))

#: What was read of each function.
_read: dict[Any, tuple[bytes, list[Any]]] = {}


class UnreadableError(TypeError):
    """Something that a kernel reaches has no digest, so the kernel cannot be kept."""


def kernel_key(kernel: Any) -> str:
    """Digest of a kernel and of everything that it can reach; raises UnreadableError."""
    digest = hashlib.sha256(_ground())
    numbers = {kernel: 0}
    reached = [kernel]
    for function in reached:
        own, callees = _own(function)
        digest.update(own)
        for callee in callees:
            if callee not in numbers:
                numbers[callee] = len(reached)
                reached.append(callee)
            digest.update(b"%d," % numbers[callee])
    return digest.hexdigest()


def signature_key(signature: Any, processor: tuple[str, ...]) -> str:
    """Digest of the types of a kernel's arguments, and of the processor; raises UnreadableError."""
    kinds = sigutils.normalize_signature(signature)
    return hashlib.sha256(f"{processor!r} {_kind(kinds)}".encode()).hexdigest()


@cache
def _ground() -> bytes:
    """Describe what every kernel depends on."""
    versions = (sys.version, numba.__version__, llvmlite.__version__, np.__version__)
    settings = [(name, str(getattr(numba.config, name, None))) for name in _SETTINGS]
    return repr((versions, settings)).encode()


def _own(function: Any) -> tuple[bytes, list[Any]]:
    """Digest of a kernel, an intrinsic or a function by itself, and what it refers to, in order."""
    if function in _read:
        return _read[function]
    own = _read_function(function)
    spec = getattr(sys.modules.get(_python(function).__module__), "__spec__", None)
    if spec is not None and not getattr(spec, "_initializing", False):
        _read[function] = own  # its module has been imported to the end: no name is missing
    return own


def _read_function(function: Any) -> tuple[bytes, list[Any]]:
    reader, python = _Reader(), _python(function)
    text = [str(python.__module__), python.__qualname__, reader.code(python.__code__)]
    text += [reader.text(python.__defaults__), reader.text(python.__kwdefaults__)]
    if is_jitted(function):
        text += [reader.text(function.targetoptions), reader.text(function.locals)]
    elif isinstance(function, _Intrinsic):
        text += [f"intrinsic {function._prefer_literal}", reader.text(function._ctor_kwargs)]
    for cell in python.__closure__ or ():
        try:
            text.append(reader.text(cell.cell_contents))
        except ValueError:
            raise UnreadableError(f"a variable of {python} has no value yet") from None
    for name in sorted(reader.names & python.__globals__.keys()):
        text += [name, reader.text(python.__globals__[name])]
    whole = "".join(f"{len(part)} {part}" for part in text)
    return hashlib.sha256(whole.encode()).digest(), reader.functions


def _python(function: Any) -> FunctionType:
    """Take the function out of a kernel or an intrinsic."""
    if is_jitted(function):
        return function.py_func
    return function._defn if isinstance(function, _Intrinsic) else function


class _Reader:
    """Text for the code and the values of one function, with what it refers to."""

    def __init__(self) -> None:
        self.names: set[str] = set()
        self.functions: list[Any] = []
        self._modules: set[str] = set()

    def code(self, code: CodeType) -> str:
        """Describe a function's code, without its docstring and its lines."""
        self.names.update(code.co_names)
        constants, plain = list(code.co_consts), code.co_code.hex()
        # A text that stands first and is never loaded is the docstring.
        loaded = any(bytes((operation, 0)) in code.co_code for operation in hasconst)
        if constants and isinstance(constants[0], str) and not loaded:
            constants[0] = None
        names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        counts = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags)
        inner = [self.text(constant) for constant in constants]
        return repr((plain, code.co_exceptiontable, names, counts, inner))

    def text(self, value: Any) -> str:
        """Describe a value as it is frozen in machine code."""
        kind = type(value)
        if kind in _PLAIN:
            return f"{kind.__name__} {value!r}"
        if isinstance(value, (FunctionType, _Intrinsic)) or is_jitted(value):
            return self._function(value)
        if isinstance(value, CodeType):
            return self.code(value)
        if isinstance(value, ModuleType):
            return self._module(value)
        if isinstance(value, type):
            return self._class(value)
        if isinstance(value, types.Type):
            return _kind(value)
        if isinstance(value, _NAMED) and _sealed(value.__module__):
            return f"{value.__module__} {value.__name__}"
        if kind.__module__ == "typing":
            return repr(value)
        return self._several(value)

    def _function(self, function: Any) -> str:
        """Describe a function that is read by itself, unless it is another package's."""
        python = _python(function)
        if _sealed(python.__globals__.get("__name__")):
            return f"{python.__module__} {python.__qualname__}"
        self.functions.append(function)
        return "function"

    def _several(self, value: Any) -> str:
        """Describe a value that is made of others."""
        kind = self.text(type(value))
        if isinstance(value, enum.Enum):
            return f"{kind} {value.name}"
        if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            bytes_ = hashlib.sha256(value.tobytes()).hexdigest()
            return repr((kind, repr(value.dtype), value.shape, value.strides, bytes_))
        if isinstance(value, np.dtype):
            return repr(value)
        if isinstance(value, tuple | list):
            return repr((kind, [self.text(part) for part in value]))
        if isinstance(value, dict):
            return repr((kind, [self.text(part) for part in value.items()]))
        if isinstance(value, set | frozenset):
            return repr((kind, sorted(self.text(part) for part in value)))
        raise UnreadableError(f"a value of {type(value)} has no digest")

    def _module(self, module: ModuleType) -> str:
        """Describe what the names in the code may take from a module."""
        text = [module.__name__]
        if not _sealed(module.__name__) and module.__name__ not in self._modules:
            self._modules.add(module.__name__)
            absent = object()
            for name in sorted(self.names):
                value = getattr(module, name, absent)
                if value is not absent:
                    text += [name, self.text(value)]
        return repr(text)

    def _class(self, kind: type) -> str:
        """Describe what a kernel can do with a class."""
        text = [kind.__module__, kind.__qualname__]
        if issubclass(kind, enum.Enum):
            members = kind.__members__.items()
            text += [f"{name} {self.text(member.value)}" for name, member in members]
        elif issubclass(kind, tuple) and hasattr(kind, "_fields"):
            text += [*vars(kind)["_fields"], self.text(vars(kind)["_field_defaults"])]
        elif not _sealed(kind.__module__) and not issubclass(kind, BaseException):
            raise UnreadableError(f"{kind} has no digest")
        return repr(text)


def _sealed(module: str | None) -> bool:
    return module is not None and module.partition(".")[0] in _SEALED


def _kind(kind: Any) -> str:
    """Describe a type of Numba with the types and classes in it.

    Its own name lacks the fields of a named tuple.
    """
    if isinstance(kind, type):
        return _Reader().text(kind)
    if isinstance(kind, types.Callable):
        raise UnreadableError(f"an argument of type {kind} has no digest")
    if isinstance(kind, tuple):
        return f"({','.join([_kind(part) for part in kind])})"
    if not isinstance(kind, types.Type):
        return repr(kind)
    parts = [part for part in vars(kind).values() if isinstance(part, types.Type | tuple | type)]
    return f"{type(kind).__qualname__} {kind.name}{_kind(tuple(parts))}"
