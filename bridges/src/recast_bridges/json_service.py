"""Another program that answers JSON over HTTP: one connection a question, and limits on all of it.

Nothing stays open between two questions, so that an object that asks can be copied into other
processes.
"""

from __future__ import annotations

import json
import re
import socket
from contextlib import suppress
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException, HTTPResponse
from threading import Timer
from time import monotonic
from typing import Any, Literal, Self

from recast.core.errors import InputError, UnreachableError
from recast.core.files import parse_json

_ADDRESS = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):([0-9]{1,5})")
_SHOWN = 200
"""Characters of another program's own words that an error shows."""


@dataclass(frozen=True)
class JsonService:
    """Where a program listens, and what it is called in errors."""

    name: str  # name of the part that it stands for, such as "planner neuroncap:localhost:9000"
    host: str  # name or address, an IPv6 address without brackets
    port: int  # port number, 1 to 65535

    @classmethod
    def at(cls, address: str, name: str) -> Self:
        """The program at HOST:PORT. Raises InputError: it is no such address."""
        found = _ADDRESS.fullmatch(address)
        if found is None or not 1 <= int(found[2]) <= 65535:
            mend = "give HOST:PORT, such as 127.0.0.1:9000"
            raise InputError(name, address, "is not an address", mend)
        return cls(name, found[1].strip("[]"), int(found[2]))

    def ask(
        self,
        method: Literal["GET", "POST"],
        path: str,
        value: object = None,
        *,
        seconds: float,
        most_bytes: int,
    ) -> Any:
        """The value of the JSON that it answers. Raises InputError: see `send`; or the answer is no
        JSON."""
        data = self.send(method, path, value, seconds=seconds, most_bytes=most_bytes)
        try:
            return parse_json(self.name, data)
        except InputError as error:
            raise self.fault(path, f"its answer {error.problem}") from None

    def send(
        self,
        method: Literal["GET", "POST"],
        path: str,
        value: object = None,
        *,
        seconds: float,
        most_bytes: int,
    ) -> bytes:
        """The bytes that it answers.

        Args:
            path: path with its slash, such as "/infer".
            value: JSON-able body of a POST.
            seconds: wall-clock limit of all of it, from connecting to the last byte.
            most_bytes: longest answer.

        Raises:
            UnreachableError: nobody listens, or the connection breaks.
            InputError: the answer is late or too long, or has another status than 2xx, whose text
                is shown.
        """
        body = None
        if method == "POST":
            body = json.dumps(value, separators=(",", ":"), allow_nan=False).encode()
        return self._exchange(method, path, body, seconds, most_bytes)

    def fault(self, path: str, problem: str) -> InputError:
        """An error of this program."""
        return InputError(self.name, path, problem, "see the log of that program")

    def _exchange(
        self, method: str, path: str, body: bytes | None, seconds: float, most: int
    ) -> bytes:
        late = self.fault(path, f"has not answered within {seconds:g} s")
        ends = monotonic() + seconds
        connection = HTTPConnection(self.host, self.port, timeout=seconds)
        timer: Timer | None = None
        try:
            connection.connect()
            # A timeout of the socket would begin anew with each byte that drips in.
            timer = Timer(max(0.0, ends - monotonic()), _shut, [connection.sock])
            timer.daemon = True
            timer.start()
            headers = {"Connection": "close"}
            if body is not None:
                headers["Content-Type"] = "application/json"
            # Who refuses a body need not read it all; the answer says why.
            with suppress(BrokenPipeError, ConnectionResetError):
                connection.request(method, path, body, headers)
            data = self._read(path, connection.getresponse(), most)
        except (OSError, HTTPException, InputError) as error:
            if isinstance(error, TimeoutError) or monotonic() >= ends:
                raise late from None
            if isinstance(error, InputError):
                raise
            mend = "start that program, or see its log"
            raise UnreachableError(self.name, path, _told(error), mend) from None
        finally:
            if timer is not None:
                timer.cancel()
            connection.close()
        if monotonic() >= ends:
            raise late
        return data

    def _read(self, path: str, response: HTTPResponse, most: int) -> bytes:
        data = response.read(most + 1)
        if not 200 <= response.status < 300:
            said = data[: 4 * _SHOWN].decode("utf-8", "replace").strip()[:_SHOWN]
            raise self.fault(path, f"answered {response.status} {response.reason}: {said}")
        if len(data) > most:
            raise self.fault(path, f"its answer has more than {most} bytes")
        if response.length:  # what was announced and did not come
            raise self.fault(path, "its answer is cut off")
        return data


def _shut(sock: socket.socket) -> None:
    try:
        sock.shutdown(socket.SHUT_RDWR)
    except OSError:  # closed meanwhile
        return


def _told(error: OSError | HTTPException) -> str:
    """What happened, for people."""
    if isinstance(error, ConnectionRefusedError):
        return "no program listens there"
    text = (error.strerror if isinstance(error, OSError) else None) or str(error)
    return f"the connection failed ({text or type(error).__name__})"
