"""For the tests: strangers that say what they like, and a fleet of honest robots to say it to, over real Zenoh."""

from __future__ import annotations

import json
import os
import selectors
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

import zenoh

LIFE = "0123456789abcdef"
TOKEN = f"alive/{LIFE}"
SAID = tuple(f"{kind}/{LIFE}" for kind in ("delta", "digest"))
ANSWERED = tuple(f"{kind}/{LIFE}" for kind in ("snapshot", "revisions", "mirror", "relay", "stats"))
"""What there is under fleetmap/<fleet>/<robot>/: the token of who lives, samples, and answers to questions."""

HONEST_PEER = Path(__file__).parent / "honest_peer.py"


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

    def __enter__(self) -> Self:
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

    def respond(self, key: str, answer: Callable[[bytes], Iterable[bytes]]) -> None:
        """Answer each question to ``key`` with what ``answer`` makes of its payload."""

        def reply(asked: zenoh.Query) -> None:
            with asked:
                for payload in answer(asked.payload.to_bytes() if asked.payload is not None else b""):
                    asked.reply(key, payload)

        self._declared.append(self.session.declare_queryable(key, reply))

    def react(self, key: str, then: Callable[[str, bytes], None]) -> None:
        """Do something at once about each sample under ``key``."""

        def hear(sample: zenoh.Sample) -> None:
            then(str(sample.key_expr), sample.payload.to_bytes())

        self._declared.append(self.session.declare_subscriber(key, hear, allowed_origin=zenoh.Locality.REMOTE))

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


class Fleet:
    """Honest robots, each a process of its own, over TCP on loopback; no multicast. ``with`` starts and ends them.

    Parameters
    ----------
    robots : their names; they join in this order, and each dials those before it
    late : names of robots that are not started before ``start`` says so
    fleet : its name
    rooms : square rooms, of 4 edges, in the map of each; one more stands elsewhere after each change
    options : further options of ``fleetmap.join``
    timeout_s : of starting, and of each command

    Attributes
    ----------
    endpoints : by robot, where a stranger may dial it
    lives : by robot, the life of its last start
    published : by robot and life, the digest of its last map

    Raises
    ------
    TimeoutError : a robot doesn't answer in time
    RuntimeError : a command failed, or a robot's process has ended; the message says with what
    """

    def __init__(
        self,
        robots: Sequence[str] = ("a", "b", "c", "d"),
        *,
        late: Sequence[str] = (),
        fleet: str = "test",
        rooms: int = 50,
        options: Mapping[str, object] | None = None,
        timeout_s: float = 20.0,
    ) -> None:
        self.robots, self.fleet, self._first = (*robots, *late), fleet, tuple(robots)
        self.endpoints = dict(zip(self.robots, free_endpoints(len(self.robots)), strict=True))
        self.lives: dict[str, str] = {}
        self.published: dict[str, str] = {}
        self._rooms, self._options, self._timeout_s = rooms, dict(options or {}), timeout_s
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._unread: dict[str, bytes] = {}
        self._change = dict.fromkeys(self.robots, -1)
        self._asked = 0

    def __enter__(self) -> Self:
        try:
            for robot in self._first:
                self.start(robot)
            for robot in self._first:
                self.joined(robot)
                self.publish(robot)
            self.synced(at_least=len(self._first) - 1)
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self, robot: str, **further: object) -> None:
        """Start a robot, or start it again after ``kill``; it does what it is asked once it has joined.

        ``further`` options of ``fleetmap.join``, or another ``row`` for its rooms.
        """
        place = self.robots.index(robot)
        options = {
            "fleet": self.fleet,
            "profile": "local",
            "listen": [self.endpoints[robot]],
            "connect": [self.endpoints[other] for other in self.robots[:place]],
            "count": self._rooms,
            "row": place,
            **self._options,
            **further,
        }
        self._processes[robot] = subprocess.Popen(
            [sys.executable, str(HONEST_PEER), robot, json.dumps(options)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._unread[robot] = b""

    def joined(self, robot: str) -> None:
        """Wait until a robot that was started has joined."""
        self.lives[robot] = str(self._read(robot, 0, self._timeout_s)["life"])

    def kill(self, robot: str) -> None:
        """End a robot without a word."""
        process = self._processes.pop(robot)
        process.kill()
        process.wait()
        for pipe in (process.stdin, process.stdout):
            with suppress(BrokenPipeError):
                pipe.close()  # type: ignore[union-attr]

    def close(self) -> None:
        """End all robots, with a word where they still listen."""
        for process in self._processes.values():
            with suppress(BrokenPipeError):
                process.stdin.close()  # type: ignore[union-attr]
        until_s = time.monotonic() + self._timeout_s
        for robot, process in list(self._processes.items()):
            with suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, until_s - time.monotonic()))
            self.kill(robot)

    @property
    def running(self) -> tuple[str, ...]:
        """The robots that were started and not killed."""
        return tuple(self._processes)

    def publish(self, robot: str, *, timeout_s: float | None = None) -> float:
        """Have a robot publish its next small change; when it was told to, by the clock of ``time.monotonic``."""
        self._change[robot] += 1
        answer = self.ask(robot, "publish", timeout_s=timeout_s, change=self._change[robot])
        self.published[f"{robot}/{self.lives[robot]}"] = str(answer["map"])
        return float(answer["began_s"])  # type: ignore[arg-type]

    def latencies_s(self, changes: int, *, timeout_s: float | None = None) -> list[float]:
        """Publish so many small changes, robot by robot in turn, each once the last one is held everywhere.

        Returns
        -------
        list[float] : seconds from publish to held, of each change at each other robot, ascending
        """
        found = []
        for i in range(changes):
            author = self.running[i % len(self.running)]
            began_s = self.publish(author, timeout_s=timeout_s)
            found += [held_s - began_s for held_s in self.held_s(author, timeout_s=timeout_s).values()]
        return sorted(found)

    def held_s(self, author: str, *, timeout_s: float | None = None) -> dict[str, float]:
        """By other robot, since when it holds the last change of a robot, or a later one; waits until all do."""
        change, wait_s = self._change[author], timeout_s or self._timeout_s
        others = [robot for robot in self.running if robot != author]
        answers = self.ask_all(others, "held", robot=author, life=self.lives[author], change=change, timeout_s=wait_s)
        return {
            robot: min(since_s for held, since_s in answer["held_s"].items() if int(held) >= change)  # type: ignore[attr-defined]
            for robot, answer in answers.items()
        }

    def digests(self) -> dict[str, str]:
        """By robot, the digest of its merged map of all that it holds now."""
        return {robot: str(answer["digest"]) for robot, answer in self.ask_all(self.running, "digest").items()}

    def synced(self, *, at_least: int = 0, timeout_s: float | None = None) -> dict[str, str | None]:
        """By robot, the digest that ``synced()`` returns; None where it times out."""
        answers = self._synced(at_least, timeout_s)
        return {robot: answer.get("digest") for robot, answer in answers.items()}  # type: ignore[misc]

    def synced_lies(self, *, timeout_s: float) -> list[str]:
        """Whose map is not right at whom, though ``synced()`` has returned there. Nobody must publish meanwhile."""
        return [
            f"{author} at {robot}"
            for robot, answer in self._synced(0, timeout_s).items()
            for author, digest in self.published.items()
            if "maps" in answer and answer["maps"].get(author) != digest  # type: ignore[attr-defined]
        ]

    def missing(self, *, timeout_s: float) -> list[str]:
        """What ``synced()`` says that is missing; empty if it returns at all robots, and with one digest."""
        answers = self._synced(len(self.running) - 1, timeout_s)
        told = [str(answer["missing"])[:300] for answer in answers.values() if "missing" in answer]
        digests = {str(answer["digest"]) for answer in answers.values() if "digest" in answer}
        return told or ([f"digests {sorted(digests)}"] if len(digests) > 1 else [])

    def _synced(self, at_least: int, timeout_s: float | None) -> dict[str, dict[str, object]]:
        wait_s = timeout_s or self._timeout_s
        return self.ask_all(self.running, "synced", timeout_s=wait_s, at_least=at_least)

    def wrong(self) -> list[str]:
        """Whose map is not merged at whom as its author published it last; empty if all is right."""
        held = self.ask_all(self.running, "maps")
        return [
            f"{author} at {robot}"
            for robot, answer in held.items()
            for author, digest in self.published.items()
            if answer["maps"].get(author) != digest  # type: ignore[attr-defined]
        ]

    def unseen(self) -> list[str]:
        """Which running robot is absent for which other; empty if each sees all."""
        seen = self.ask_all(self.running, "alive")
        return [
            f"{other} for {robot}"
            for robot, answer in seen.items()
            for other in self.running
            if other != robot and other not in answer["alive"]  # type: ignore[operator]
        ]

    def dropped(self, robot: str) -> int:
        """How many messages a robot refused."""
        return sum(self.ask(robot, "dropped")["dropped"].values())  # type: ignore[attr-defined]

    def until(self, condition: Callable[[], bool], *, timeout_s: float | None = None) -> float:
        """Wait for what the robots get to know of; how many seconds that took."""
        began_s = time.monotonic()
        while not condition():
            if time.monotonic() - began_s > (timeout_s or self._timeout_s):
                raise TimeoutError(f"not so within {timeout_s or self._timeout_s:.0f} s")
            self.ask(self.running[0], "step")
        return time.monotonic() - began_s

    def until_none(self, faults: Callable[[], list[str]], *, timeout_s: float) -> float:
        """Wait until there is no fault; how many seconds that took."""
        found: list[str] = []

        def whole() -> bool:
            found[:] = faults()
            return not found

        try:
            return self.until(whole, timeout_s=timeout_s)
        except TimeoutError as error:
            raise TimeoutError(f"{error}: {found[:4]}") from None

    def rss_bytes(self) -> dict[str, int]:
        """By robot, the memory of its process."""
        pages = {r: Path(f"/proc/{p.pid}/statm").read_text().split()[1] for r, p in self._processes.items()}
        return {robot: int(count) * os.sysconf("SC_PAGE_SIZE") for robot, count in pages.items()}

    def ask(self, robot: str, do: str, *, timeout_s: float | None = None, **fields: object) -> dict[str, object]:
        """Have one robot do something; its answer. See ``HonestPeer`` for what there is."""
        return self.ask_all([robot], do, answer_s=timeout_s, **fields)[robot]

    def ask_all(
        self, robots: Iterable[str], do: str, *, answer_s: float | None = None, **fields: object
    ) -> dict[str, dict[str, object]]:
        """Have some robots do the same at once; their answers."""
        self._asked += 1
        number, robots = self._asked, list(robots)
        line = json.dumps({"id": number, "do": do, **fields}).encode() + b"\n"
        for robot in robots:
            stdin = self._processes[robot].stdin
            stdin.write(line)  # type: ignore[union-attr]
            stdin.flush()  # type: ignore[union-attr]
        # A command that waits says so itself when its own time is over.
        wait_s = answer_s or self._timeout_s + float(fields.get("timeout_s", 0.0))  # type: ignore[arg-type]
        answers = {robot: self._read(robot, number, wait_s) for robot in robots}
        for robot, answer in answers.items():
            if "error" in answer:
                raise RuntimeError(f"{robot}, {do}: {answer['error']}")
        return answers

    def _read(self, robot: str, number: int, timeout_s: float) -> dict[str, object]:
        """The answer of that number; earlier ones that came too late are skipped."""
        stdout, until_s = self._processes[robot].stdout, time.monotonic() + timeout_s
        with selectors.DefaultSelector() as ready:
            ready.register(stdout, selectors.EVENT_READ)  # type: ignore[arg-type]
            while True:
                line, end, rest = self._unread[robot].partition(b"\n")
                if end:
                    self._unread[robot] = rest
                    answer: dict[str, object] = json.loads(line)
                    if answer["id"] == number:
                        return answer
                    continue
                if not ready.select(max(0.0, until_s - time.monotonic())):
                    raise TimeoutError(f"{robot}: no answer within {timeout_s:.0f} s")
                piece = os.read(stdout.fileno(), 1 << 16)  # type: ignore[union-attr]
                if not piece:
                    raise RuntimeError(f"{robot}: ended with {self._processes[robot].wait()}")
                self._unread[robot] += piece


def free_endpoints(count: int) -> list[str]:
    """TCP endpoints on loopback that nobody listens at, no two alike."""
    probes = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    try:
        return [f"tcp/127.0.0.1:{probe.getsockname()[1]}" for probe in probes]
    finally:
        for probe in probes:
            probe.close()
