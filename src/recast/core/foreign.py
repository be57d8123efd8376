"""Code of users: completed once, handed read-only data, and kept from changing the process."""

from __future__ import annotations

import inspect
import os
import random
import signal
import sys
import sysconfig
import threading
import traceback
import warnings
from abc import ABC
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from functools import cache, cached_property
from pathlib import Path
from types import FunctionType
from typing import Any, NoReturn, TypeVar

import numpy as np

from recast.core.errors import InputError, nearest

Value = TypeVar("Value")

_LIBRARIES = (
    *{sysconfig.get_path(name) + os.sep for name in ("stdlib", "platstdlib", "purelib", "platlib")},
    str(Path(__file__).parents[1]) + os.sep,
)
"""Folders of code that is not a user's."""
_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_ABSENT = object()
_ALIKE = 0.85
"""Ratio of `difflib` from which two names are taken for a slip: "wanted_veiws" has 0.92."""
_PLAIN: Mapping[str, tuple[type, ...]] = {"str": (str,), "bool": (bool, np.bool_)}
"""Types of values that are checked, by annotation."""


class ReadOnlyDict(dict[Any, Any]):
    """A dict that cannot be changed; its copies are plain dicts."""

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise TypeError("the mapping is read-only")

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> tuple[type[dict[Any, Any]], tuple[dict[Any, Any]]]:
        return dict, (dict(self),)


def read_only(value: Value) -> Value:
    """The same value, whose arrays, mappings and lists cannot be written into.

    Arrays become views, so nothing large is copied; dataclasses are made anew if a member differs;
    lists become tuples; whatever else there is stays as it is.
    """
    made: Any = value
    if isinstance(value, np.ndarray):
        if value.flags.writeable:
            made = value.view()
            made.flags.writeable = False
    elif isinstance(value, Mapping):
        if not isinstance(value, ReadOnlyDict):
            made = ReadOnlyDict({key: read_only(member) for key, member in value.items()})
    elif type(value) in (tuple, list):
        members = tuple(read_only(member) for member in value)  # type: ignore[attr-defined]
        if type(value) is list or any(a is not b for a, b in zip(members, made, strict=True)):
            made = members
    elif is_dataclass(value) and not isinstance(value, type):
        before = {one.name: getattr(value, one.name) for one in fields(value)}
        after = {name: read_only(member) for name, member in before.items()}
        if any(after[name] is not before[name] for name in before):
            made = object.__new__(type(value))
            for name, member in {**_kept(value), **after}.items():
                object.__setattr__(made, name, member)
    return made


def _kept(value: object) -> dict[str, Any]:
    """Attributes without the cached ones, whose arrays would be shared and writeable."""
    return {
        name: member
        for name, member in getattr(value, "__dict__", {}).items()
        if not isinstance(getattr(type(value), name, None), cached_property)
    }


class BasePart(ABC):  # noqa: B024  # its subclasses have abstract members
    """Base of the base classes of users' parts: planners, motions, generators and so on.

    A base class has every member that recast asks for. A part must have those that are abstract
    or annotated without a value; the others are defaults. `copy.deepcopy` makes an independent
    part in the same state.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        bases = [kind for kind in cls.__mro__[1:] if BasePart in kind.__bases__]
        if bases:
            warn_of_slips(cls, bases[0])


class Around:
    """A part that does what another one does, except for what its own class says.

    Derive from it and then from the base class of the part: `class Mine(Around, BasePlanner)`.

    Args:
        part: the other part, of any class.
    """

    def __init__(self, part: Any) -> None:
        self.part = part

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if Around in cls.__bases__:
            base = cls.__bases__[cls.__bases__.index(Around) + 1]
            for name in _members(base) - vars(cls).keys():
                setattr(cls, name, _Forwarded(name, inspect.getattr_static(base, name, None)))


class _Forwarded:
    """A member of a base class in a part `Around` another: the other's, or else the default."""

    def __init__(self, name: str, default: Any) -> None:
        self._name, self._default = name, default

    def __get__(self, around: Around | None, owner: type | None = None) -> Any:
        if around is None:
            return self
        try:
            return getattr(around.part, self._name)
        except AttributeError:
            if inspect.getattr_static(around.part, self._name, self) is not self:
                raise  # a fault inside of a property
        bound = inspect.isfunction(self._default) or isinstance(self._default, property)
        return self._default.__get__(around, owner) if bound else self._default


def whole(part: object, base: type[Value]) -> Value:
    """The part, with every member of its base class.

    A part of another class is completed: what it lacks is the default of the base. A member whose
    name is nearly that of an optional one is warned about, see `warn_of_slips`.

    Raises:
        InputError: it is a class, lacks a member that has no default, or has a value where a
            method belongs, a method where a value belongs, or a value of the wrong type.
    """
    if isinstance(part, base):
        return part
    kind: Any = part if isinstance(part, type) else type(part)
    where, see = f"{kind.__module__}.{kind.__qualname__}", f"see {base.__module__}.{base.__name__}"
    if isinstance(part, type):
        raise InputError(where, "part", "is a class", f"call {kind.__name__}, give what it returns")
    for name in lacks(part, base):
        near = nearest(name, (own for own in dir(kind) if not own.startswith("_")))
        raise InputError(where, name, "is missing", f"{f'is it {near}? ' if near else ''}{see}")
    seam: Any = base  # mypy takes the hash of an instance for that of a class
    for name in sorted(_members(seam)):
        if fault := _fault(part, base, name):
            raise InputError(where, name, fault, f"correct it; {see}")
    completed: Callable[[object], Value] = _completed(kind, seam)
    return completed(part)


def lacks(part: object, base: type) -> tuple[str, ...]:
    """Names of the members without a default that a part does not have."""
    names = (name for name in sorted(_members(base)) if not _is_optional(base, name))
    return tuple(name for name in names if not hasattr(part, name))


@cache
def warn_of_slips(kind: type, base: type) -> None:
    """Warn once of public members of a class, in one line each, that are likely slips.

    Those are named nearly as an optional member of the base that the class does not have:
    `choose_camera` for `choose_cameras`.
    """
    known = _members(base)
    own = {name: k for k in kind.__mro__ if k not in base.__mro__ for name in vars(k)}
    wanted = sorted(name for name in known - own.keys() if _is_optional(base, name))
    for name in vars(kind).keys() - known if issubclass(kind, base) else own.keys() - known:
        near = get_close_matches(name, wanted, 1, _ALIKE)
        if near and not name.startswith("_"):
            warnings.warn(
                f"{kind.__module__}.{kind.__qualname__} has {name}, which recast does not ask for; "
                f"is it {near[0]}?",
                stacklevel=4,
            )


@cache
def _members(base: type) -> frozenset[str]:
    """Names of all that recast asks a part for."""
    kinds = base.__mro__[: base.__mro__.index(BasePart)]
    names = {name for kind in kinds for name in (*vars(kind), *inspect.get_annotations(kind))}
    return frozenset(name for name in names if name == "__call__" or not name.startswith("_"))


def _is_optional(base: type, name: str) -> bool:
    abstract: frozenset[str] = base.__abstractmethods__  # type: ignore[attr-defined]
    return name not in abstract and hasattr(base, name)


def _fault(part: object, base: type, name: str) -> str | None:
    """What is wrong with the kind of a member; properties are not read."""
    given = inspect.getattr_static(part, name, _ABSENT)
    is_method = isinstance(given, FunctionType | staticmethod | classmethod)
    if given is _ABSENT or (hasattr(given, "__get__") and not is_method):
        return None
    if inspect.isfunction(inspect.getattr_static(base, name, None)):
        return None if is_method or callable(given) else "is not a method"
    if is_method:
        return "is a method, not a value"
    annotations = [inspect.get_annotations(kind).get(name, "") for kind in base.__mro__]
    kinds = _PLAIN.get(next(filter(None, annotations), ""), (object,))
    return None if isinstance(given, kinds) else f"is not of the type {kinds[0].__name__}"


@cache
def _completed(kind: type, base: type) -> Any:
    """The class that completes parts of a class, which looks like that class."""
    warn_of_slips(kind, base)
    names = {"__module__": kind.__module__, "__qualname__": kind.__qualname__}
    again = {"__reduce__": lambda self: (whole, (self.part, base))}
    return type(kind.__name__, (Around, base), {**names, **again})


class ForeignCode:
    """Code of one user's part: each call into it is guarded.

    An exit is an error; working directory, signal handlers, standard streams, threads and defaults
    of torch, OpenCV and numpy, and warning filters are put back after each call. `random`, `numpy`
    and `torch` draw from streams of the part's own, which go on from call to call.

    Args:
        who: name of the part for errors, such as "planner idm-follower".
        seed: seed of the streams.
        part: the part; if its class is one of recast's, its calls are not guarded, which costs
            0.2 ms each.
    """

    def __init__(self, who: str, seed: int = 0, part: object = None) -> None:
        self.who, self._seed = who, seed
        self._own = type(part).__module__.startswith("recast.")
        self._streams: dict[str, Any] = {}

    @contextmanager
    def call(self, what: str) -> Iterator[None]:
        """Guard one call.

        Args:
            what: the call, for errors, such as "plan at step 5".

        Raises:
            InputError: the code ends the program, or writes into a read-only object.
            Exception: whatever else the code raises.
        """
        if self._own:
            yield
            return
        with process_kept(self._seed, self._streams):
            try:
                yield
            except (KeyboardInterrupt, InputError, OSError):
                raise
            except Exception as error:
                if not _refers_to_read_only(error):
                    raise
                problem = f"writes into a read-only object ({type(error).__name__}: {error})"
                mend = "copy what recast hands over before you change it, such as array.copy()"
                raise InputError(self.who, what, problem, mend) from error
            except BaseException as error:
                problem = f"ends the program ({type(error).__name__}: {error})"
                mend = "raise an exception that says what is wrong"
                raise InputError(self.who, what, problem, mend) from error


@contextmanager
def foreign_call(who: str, what: str, code: object, seed: int = 0) -> Iterator[None]:
    """Guard one call of a user's code; what it raises is one line with the place that raised it.

    Args:
        who: name of the part, such as "importer mine:load".
        what: the call, such as the path that it reads.
        code: function or object; if it is one of recast's, its exceptions are faults of recast.
        seed: see `ForeignCode`.

    Raises:
        InputError: the code raises an exception; or see `ForeignCode.call`.
    """
    try:
        with ForeignCode(who, seed).call(what):
            yield
    except InputError:
        raise
    except Exception as error:
        module = code.__module__ if isinstance(code, FunctionType) else type(code).__module__
        if module.startswith("recast."):
            raise
        problem = f"raises {type(error).__name__}: {error}{place_of(error)}"
        hint = "correct that code; recast --verbose shows the traceback"
        raise InputError(who, what, problem, hint) from error


def place_of(error: BaseException) -> str:
    """The line of a user's module where an exception came from, such as ", planner.py line 3"."""
    if isinstance(error, SyntaxError):
        return ""  # its text has the line
    frames = [
        (frame.filename, frame.lineno)
        for frame in traceback.extract_tb(error.__traceback__)
        if not frame.filename.startswith("<")
    ]
    users = [frame for frame in frames if not frame[0].startswith(_LIBRARIES)]
    for name, line in (users or frames)[-1:]:
        return f", {Path(name).name} line {line}"
    return ""


def _refers_to_read_only(error: Exception) -> bool:
    with suppress(Exception):  # its message may be faulty, too
        text = str(error).lower()
        return "read-only" in text or "readonly" in text
    return False


def _torch_states(torch: Any) -> tuple[Any, Any]:
    cuda = torch.cuda.is_available() and torch.cuda.is_initialized()
    return torch.get_rng_state(), torch.cuda.get_rng_state_all() if cuda else None


def _set_torch_states(torch: Any, states: tuple[Any, Any]) -> None:
    torch.set_rng_state(states[0])
    if states[1] is not None:
        torch.cuda.set_rng_state_all(states[1])


_RANDOM: dict[str, tuple[Callable[[], Any], Callable[[Any], Any], Callable[[int], Any]]] = {
    "random": (random.getstate, random.setstate, random.seed),
    "numpy": (np.random.get_state, np.random.set_state, np.random.seed),
    "torch": (
        lambda: _torch_states(sys.modules["torch"]),
        lambda states: _set_torch_states(sys.modules["torch"], states),
        lambda seed: sys.modules["torch"].manual_seed(seed),
    ),
}
"""Library: how its state is read, set and seeded."""


def _random_states() -> dict[str, Any]:
    return {name: read() for name, (read, *_) in _loaded(_RANDOM).items()}


def _set_device(torch: Any, device: Any) -> None:
    torch.set_default_device(None if device.type == "cpu" else device)  # a CPU default costs time


_SETTINGS: dict[str, tuple[tuple[Callable[[Any], Any], Callable[[Any, Any], Any]], ...]] = {
    "os": ((lambda os: _folder(), lambda os, before: os.chdir(before)),),
    "numpy": ((lambda numpy: numpy.geterr(), lambda numpy, before: numpy.seterr(**before)),),
    "cv2": ((lambda cv2: cv2.getNumThreads(), lambda cv2, before: cv2.setNumThreads(before)),),
    "torch": (
        (lambda torch: torch.get_num_threads(), lambda torch, n: torch.set_num_threads(n)),
        (lambda torch: torch.get_default_dtype(), lambda torch, t: torch.set_default_dtype(t)),
        (lambda torch: torch.get_default_device(), _set_device),
        (lambda torch: torch.is_grad_enabled(), lambda torch, on: torch.set_grad_enabled(on)),
        (
            lambda torch: torch.are_deterministic_algorithms_enabled(),
            lambda torch, on: torch.use_deterministic_algorithms(on),
        ),
        (
            lambda torch: torch.get_float32_matmul_precision(),
            lambda torch, words: torch.set_float32_matmul_precision(words),
        ),
    ),
}
"""Library: how each of its settings that change other code's results is read and set."""


def _loaded(table: Mapping[str, Value]) -> dict[str, Value]:
    """The entries of libraries that are imported: nothing is imported for their sake."""
    return {name: entry for name, entry in table.items() if sys.modules.get(name) is not None}


def _folder() -> str | None:
    try:
        return str(Path.cwd())
    except OSError:  # it was removed
        return None


@contextmanager
def process_kept(seed: int, streams: dict[str, Any] | None = None) -> Iterator[None]:
    """Put back what belongs to the whole process, see `ForeignCode`.

    Args:
        seed: seed of the random numbers meanwhile.
        streams: states of random numbers by library, from which they go on; kept up to date.
    """
    with _settings_kept(), _drawing(seed, {} if streams is None else streams):
        yield


@contextmanager
def _drawing(seed: int, streams: dict[str, Any]) -> Iterator[None]:
    before = _random_states()
    for library, (_, set_state, set_seed) in _loaded(_RANDOM).items():
        if library in streams:
            set_state(streams[library])
        else:
            set_seed(seed % 2**32)
    try:
        yield
    finally:
        streams |= _random_states()
        for library, (_, set_state, _) in _loaded(_RANDOM).items():
            if library in before:
                set_state(before[library])


@contextmanager
def _settings_kept() -> Iterator[None]:
    before = {
        name: [read(sys.modules[name]) for read, _ in settings]
        for name, settings in _loaded(_SETTINGS).items()
    }
    main_thread = threading.current_thread() is threading.main_thread()
    handlers = {number: signal.getsignal(number) for number in _SIGNALS} if main_thread else {}
    filters, streams = list(warnings.filters), (sys.stdout, sys.stderr)
    sys.stdout, sys.stderr = (None if one is None else _KeptOpen(one) for one in streams)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = streams
        if warnings.filters != filters:
            warnings.filters[:] = filters  # type: ignore[index]
        for number, handler in handlers.items():
            if signal.getsignal(number) != handler:
                signal.signal(number, handler)
        for name, values in before.items():
            library = sys.modules[name]
            for (read, put_back), value in zip(_SETTINGS[name], values, strict=True):
                if value is not None and read(library) != value:
                    with suppress(OSError):  # a working directory that is gone by now
                        put_back(library, value)


class _KeptOpen:
    """A standard stream that its users cannot close."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def close(self) -> None:
        """Flush alone."""
        self._stream.flush()
