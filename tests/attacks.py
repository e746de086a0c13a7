"""Strangers for the tests: bare Zenoh sessions that say what they like, under any key."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import TracebackType

import zenoh


class Stranger:
    """A Zenoh session without fleetmap, linked when it is made.

    Parameters
    ----------
    connect, listen : endpoints; each of ``connect`` must let it in
    config : further Zenoh settings, such as certificates
    timeout_s : of linking, of questions and of ``until``

    Attributes
    ----------
    heard : (key, payload) of the samples under the keys that ``listen_to`` was called with, in order
    alive : the liveliness keys that are shown under these

    Raises
    ------
    zenoh.ZError : an endpoint doesn't let it in
    """

    def __init__(
        self,
        *,
        connect: Sequence[str] = (),
        listen: Sequence[str] = ("tcp/127.0.0.1:0",),
        config: Mapping[str, object] | None = None,
        timeout_s: float = 20.0,
    ) -> None:
        settings = {
            "mode": "peer",
            "listen/endpoints": list(listen),
            "connect/endpoints": list(connect),
            "connect/timeout_ms": int(timeout_s * 1000),
            "connect/exit_on_failure": True,
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": True,
            "transport/shared_memory/enabled": False,
            **(config or {}),
        }
        prepared = zenoh.Config()
        for key, value in settings.items():
            prepared.insert_json5(key, json.dumps(value))
        self._timeout_s = timeout_s
        self._declared: list[object] = []
        self._news = threading.Condition()
        self.heard: list[tuple[str, bytes]] = []
        self.alive: set[str] = set()
        self.session = zenoh.open(prepared)

    def __enter__(self) -> Stranger:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def token(self, key: str) -> zenoh.LivelinessToken:
        """Show a liveliness token, until it is undeclared or the session ends."""
        token = self.session.liveliness().declare_token(key)
        self._declared.append(token)
        return token

    def put(self, key: str, payload: bytes) -> None:
        """Say something once, to all that listen."""
        self.session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)

    def answer(self, key: str, payloads: Iterable[bytes], *, under: str | None = None) -> None:
        """Answer each question to ``key`` with these, under the key ``under``, by default ``key`` itself."""
        replies = list(payloads)

        def reply(asked: zenoh.Query) -> None:
            with asked:
                for payload in replies:
                    asked.reply(under or key, payload)

        self._declared.append(self.session.declare_queryable(key, reply))

    def ask(self, key: str, payload: bytes = b"") -> list[tuple[str, bytes]]:
        """Ask all whose keys match; (key, payload) of the replies, ascending."""
        replies = self.session.get(
            key,
            payload=payload,
            timeout=self._timeout_s,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
        return sorted((str(r.ok.key_expr), r.ok.payload.to_bytes()) for r in replies if r.ok is not None)

    def listen_to(self, *keys: str) -> None:
        """Note from now on in ``heard`` and ``alive`` what is said under these keys."""
        for key in keys:
            self._declared += [
                self.session.declare_subscriber(key, self._hear, allowed_origin=zenoh.Locality.REMOTE),
                self.session.liveliness().declare_subscriber(key, self._see, history=True),
            ]

    def until(self, condition: Callable[[], bool]) -> None:
        """Wait for something that is told by ``heard`` or ``alive``."""
        with self._news:
            if not self._news.wait_for(condition, self._timeout_s):
                raise TimeoutError(
                    f"after {self._timeout_s:.0f} s: {len(self.heard)} heard, alive: {sorted(self.alive)}"
                )

    def close(self) -> None:
        """Leave. What it has said stays where it was believed."""
        self.session.close()

    def _hear(self, sample: zenoh.Sample) -> None:
        with self._news:
            self.heard.append((str(sample.key_expr), sample.payload.to_bytes()))
            self._news.notify_all()

    def _see(self, sample: zenoh.Sample) -> None:
        with self._news:
            (self.alive.add if sample.kind == zenoh.SampleKind.PUT else self.alive.discard)(str(sample.key_expr))
            self._news.notify_all()
