"""Calls of another program's service over gRPC: deadline, retries, and one line for each fault."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import grpc
from google.protobuf.message import DecodeError

from recast.core.errors import InputError
from recast.core.workers import Closing
from recast_bridges.alpasim.messages import (
    CHANNEL_OPTIONS,
    DEADLINE,
    PAUSES,
    Methods,
    message,
    parse,
)

_RECONNECT = (
    # Milliseconds: a server that comes back is found within the pauses.
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.min_reconnect_backoff_ms", 200),
    ("grpc.max_reconnect_backoff_ms", 1000),
)
_MEND = "see the server's log"


class ServiceClient(Closing):
    """Calls of a service; a context manager.

    Args:
        address: host:port. The channel is not secured.
        methods: request and reply of each method; `get_version` must be among them.
        paths: names of the service, tried in turn; the first one that the server knows is kept.
        deadline: seconds that a call may take.
        pauses: seconds before each further try where the server is not there (UNAVAILABLE).
        mends: what the user can do, by the name of a status code; "see the server's log" for
            others.

    Attributes:
        version: what the server calls itself, its version_id.
        full_version: the same with commit and version of the messages, as far as it says them.

    Raises:
        InputError: no such server, or it knows none of the names.
    """

    def __init__(
        self,
        address: str,
        methods: Methods,
        paths: Sequence[str],
        *,
        deadline: float = DEADLINE,
        pauses: Sequence[float] = PAUSES,
        mends: Mapping[str, str] | None = None,
    ) -> None:
        self.address, self._methods, self._mends = address, methods, mends or {}
        self._deadline, self._pauses = deadline, tuple(pauses)
        self._channel = grpc.insecure_channel(address, options=CHANNEL_OPTIONS + _RECONNECT)
        try:
            self._path, found = self._connect(paths)
        except BaseException:
            self.close()
            raise
        self.version: str = found.version_id
        self.full_version = _version_text(found)

    def _connect(self, paths: Sequence[str]) -> tuple[str, Any]:
        refused: grpc.RpcError | None = None
        for path in paths:
            try:
                return path, self._tried(path, "get_version", message("Empty"), self._deadline)
            except grpc.RpcError as error:
                if error.code() is not grpc.StatusCode.UNIMPLEMENTED:
                    raise self._failure("get_version", error) from None
                refused = error
        assert refused is not None, "no paths"
        raise self._failure("get_version", refused)

    def call(self, method: str, request: Any, deadline: float | None = None) -> Any:
        """The reply of one of the methods.

        Args:
            deadline: seconds that the call may take; None for the client's.

        Raises:
            InputError: the call failed: with the status and the text of the server.
        """
        try:
            return self._tried(self._path, method, request, deadline or self._deadline)
        except grpc.RpcError as error:
            raise self._failure(method, error) from None

    def close(self) -> None:
        """Close the channel; a call that another thread waits for ends as cancelled."""
        self._channel.close()

    def _tried(self, path: str, method: str, request: Any, deadline: float) -> Any:
        data, reply = request.SerializeToString(), self._methods[method][1]
        ask = self._channel.unary_unary(f"/{path}/{method}")
        for pause in (*self._pauses, None):
            try:
                return parse(reply, ask(data, timeout=deadline))
            except DecodeError:
                problem = f"answered with data that is not a {reply}"
                raise InputError(self.address, method, problem, _MEND) from None
            except grpc.RpcError as error:
                if error.code() is not grpc.StatusCode.UNAVAILABLE or pause is None:
                    raise
            time.sleep(pause)
        raise AssertionError  # the last try raises

    def _failure(self, method: str, error: grpc.RpcError) -> InputError:
        code = error.code().name
        mend = self._mends.get(code, _MEND)
        return InputError(self.address, method, f"{code}: {error.details()}", mend)


def _version_text(found: Any) -> str:
    """A message VersionId in words; what it leaves empty is left out."""
    api = found.grpc_api_version
    commit = f"git {found.git_hash}" if found.git_hash else ""
    number = f"{api.major}.{api.minor}.{api.patch}"
    messages = f"API {number}" if found.HasField("grpc_api_version") else ""
    return ", ".join(filter(None, (found.version_id or "unnamed", commit, messages)))
