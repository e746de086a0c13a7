"""The engine: bytes and times go in, bytes and events come out. No I/O, no thread, no clock, no randomness.

An author numbers its revisions, and a record leads from one to the next. Who finds a gap, hears a heartbeat
that is ahead, or meets a peer for the first time, asks: the author, or any peer that mirrors it. Nothing that
comes from the network raises; what is refused is counted by robot, kind and reason.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

from fleetmap.accounting import Ledger
from fleetmap.codecs import envelope
from fleetmap.codecs.messages import (
    CLAIMED_EPOCHS,
    MAX_EPSILON_CELLS,
    MAX_MM,
    NAME,
    PROFILES,
    GoalMessage,
    Header,
    Heartbeat,
    Message,
    PoseMessage,
    Record,
    Revision,
    RevisionList,
    SnapshotChunk,
    Want,
    check_name,
)
from fleetmap.engine.author import Author, revoking
from fleetmap.engine.catchup import GRACE_S, LIST, Catchup, Key
from fleetmap.engine.changes import changed_events
from fleetmap.engine.holdings import Holdings
from fleetmap.engine.log import answer
from fleetmap.engine.outputs import Ask, Changed, Detour, EpochChanged, NameTaken, Output, PeersChanged, Put
from fleetmap.engine.quota import Quota
from fleetmap.engine.reach import check_reach
from fleetmap.engine.replica import Outcome, Replica
from fleetmap.engine.stream import Stream, Submap
from fleetmap.engine.teammates import Teammates
from fleetmap.model.errors import ConfigError, WireError
from fleetmap.model.pose import FixedPose, wrap
from fleetmap.model.vectormap import VectorMap

MAX_PEERS = 512


class Engine:
    """One robot's side of the exchange.

    Parameters
    ----------
    robot : own name; unique among the living peers of the fleet
    epoch : 1 + the highest epoch of this name that is known
    instance : tells two living peers of one name apart; drawn by the caller
    level : robots of different levels are never merged
    start : T_fleet_robot, None if unknown
    heartbeat_s : how often the own revision is announced
    quota : when updates of the own map may be sent; None: at once
    """

    def __init__(
        self,
        robot: str,
        *,
        epoch: int = 1,
        instance: str = "0",
        level: str = "0",
        start: FixedPose | None = None,
        heartbeat_s: float = 2.0,
        quota: Quota | None = None,
        ledger: Ledger | None = None,
    ) -> None:
        self.robot, self.instance = check_name("robot", robot), instance
        self.ledger = ledger or Ledger()
        header = Header(check_name("level", level), start)
        self.author = Author(Stream(robot, epoch, 0, header))
        self.holdings = Holdings(self.author)
        self.alive: dict[str, set[tuple[int, str]]] = {}
        self.teammates = Teammates()
        self._heartbeat_s, self._heartbeat_due_s = heartbeat_s, 0.0
        self._listed: set[str] = set()
        self._mismatch: dict[str, tuple[int, int]] = {}
        self._catchup = Catchup()
        self._quota = quota or Quota()
        self._waiting: dict[str, Submap] = {}
        self._said_bytes = 0
        self._refused: ConfigError | None = None
        self._said: dict[str, bytes] = {}
        self._outputs: list[Output] = []
        self._commit(header=header)

    @property
    def own(self) -> Stream:
        """What this robot has said."""
        return self.author.stream

    # What the user says

    def publish(
        self, submap: str, vector_map: VectorMap, *, anchor: FixedPose | None = None, now_s: float = 0.0
    ) -> bool:
        """Say what a submap is now, or, if the quota doesn't allow it yet, as soon as it does.

        What is said then is the difference to what was said last: what came between is never sent. False if nothing
        changed, and nothing is to be sent.

        Raises
        ------
        ConfigError : the name or the profile is none; the map is too large, or too far from others of the component
            (``engine.reach``); or the whole map (or the one before, if it had to wait) grew beyond what a snapshot may
            hold
        """
        if self._refused is not None:
            refused, self._refused = self._refused, None
            raise refused
        check_name("submap", submap)
        if vector_map.profile not in PROFILES or not 0 <= vector_map.epsilon_cells <= MAX_EPSILON_CELLS:
            told = (vector_map.profile, vector_map.epsilon_cells)
            raise ConfigError(option="map", value=told, reason=f"expected {PROFILES} and at most {MAX_EPSILON_CELLS}")
        waiting = {**self._waiting, submap: Submap(vector_map, anchor or FixedPose())}
        self._check_reach(submaps={**self.own.submaps, **waiting}, submap=submap)
        self._waiting = waiting
        if self._quota.may_send(now_s):
            return self.send_waiting(now_s)
        return replace(self.own, submaps={**self.own.submaps, **self._waiting}).digest != self.own.digest

    def send_waiting(self, now_s: float) -> bool:
        """Say what waits for the quota, whether or not it allows it; False if that is nothing."""
        waiting, self._waiting = self._waiting, {}
        if not waiting or not self._commit(submaps={**self.own.submaps, **waiting}):
            return False
        self._quota.sent(self._said_bytes, now_s)
        return True

    def set_start(self, start: FixedPose | None) -> bool:
        """Say where the own map frame lies in the fleet's.

        Raises
        ------
        ConfigError : the own maps would lie too far from others of the component (``engine.reach``)
        """
        self._check_reach(header=replace(self.own.header, start=start), submaps={**self.own.submaps, **self._waiting})
        return self._commit(header=replace(self.own.header, start=start))

    def forget(self, robot: str) -> bool:
        """Drop all that a robot has said so far, here and at every peer. One that still lives comes back.

        Raises
        ------
        ConfigError : no stream of that robot is held
        """
        epochs = [epoch for name, epoch in self.holdings.replicas if name == robot]
        if not epochs:
            raise ConfigError(option="robot", value=robot, reason="no map of that robot is held")
        done = self._commit(header=revoking(self.own.header, robot, max(epochs)))
        self._drop_revoked()
        return done

    def set_pose(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Announce where the robot is, in its map frame.

        Raises
        ------
        ConfigError : a number is not finite, or too large
        """
        x_mm, y_mm = _millimetres("pose", (x_m, y_m))
        yaw_mrad = round(wrap(yaw_rad) * 1e3)
        self._say("pose", envelope.encode(PoseMessage(self.own.epoch, x_mm, y_mm, yaw_mrad)))

    def set_goal(self, goal_xy: tuple[float, float] | None) -> None:
        """Announce where the robot is going, in its map frame; None: nowhere.

        Raises
        ------
        ConfigError : a number is not finite, or too large
        """
        goal_mm = None if goal_xy is None else _millimetres("goal", goal_xy)
        self._say("goal", envelope.encode(GoalMessage(self.own.epoch, goal_mm)))

    # What the link says

    def on_message(self, robot: str, suffix: str, payload: bytes, *, now_s: float) -> None:
        """A sample under ``robot/suffix``."""
        self.ledger.received(robot, suffix, len(payload))
        try:
            if not NAME.fullmatch(robot) or robot == self.robot:
                raise WireError(robot=robot, size_bytes=len(payload), reason="namesake")
            self._on_message(robot, suffix, payload, envelope.decode(payload, robot=robot), now_s)
        except WireError as error:
            self.ledger.dropped(robot, suffix, len(payload), reason=_short(error))
        self._ask_due(now_s)

    def on_alive(self, robot: str, epoch: int, instance: str, *, now_s: float) -> None:
        """A peer's liveliness token appeared."""
        if robot == self.robot:
            # Both see the other; the one with the lower epoch was there first.
            if instance != self.instance and (epoch, instance) < (self.own.epoch, self.instance):
                self._outputs.append(NameTaken())
            return
        if not NAME.fullmatch(robot) or (robot not in self.alive and len(self.alive) >= MAX_PEERS):
            self.ledger.dropped(robot, "alive", 0, reason="too_many_peers")
            return
        if robot not in self.alive:
            self.alive[robot] = set()
            self._outputs.append(PeersChanged(robot, True))
            for suffix, payload in self._said.items():
                self._put(suffix, payload)
        self.alive[robot].add((epoch, instance))
        self.ask_list(robot, now_s=now_s)
        self._ask_due(now_s)

    def on_gone(self, robot: str, epoch: int, instance: str) -> None:
        """A peer's liveliness token vanished: its map stays, and it is absent."""
        tokens = self.alive.get(robot, set())
        tokens.discard((epoch, instance))
        if robot in self.alive and not tokens:
            del self.alive[robot]
            self._listed.discard(robot)
            self._mismatch.pop(robot, None)
            self.teammates.gone(robot)
            self._catchup.peer_gone(robot)
            self._outputs.append(PeersChanged(robot, False))

    def on_query(self, suffix: str, payload: bytes, *, robot: str = "?") -> list[bytes]:
        """The replies to a query under the own key ``suffix``: ``snapshot``, ``revisions`` or ``mirror/<robot>``."""
        kind = suffix.partition("/")[0]
        self.ledger.received(robot, f"{kind}?", len(payload))
        try:
            replies = self._answer(suffix, payload, robot)
        except (WireError, ConfigError) as error:
            self.ledger.dropped(robot, f"{kind}?", len(payload), reason=_short(error))
            return []
        for reply in replies:
            self.ledger.sent("list" if suffix == "revisions" else "repair", len(reply))
        return replies

    def on_reply(self, ask_id: int, payload: bytes, *, now_s: float) -> None:
        """A reply to an ``Ask``."""
        about = self._catchup.about(ask_id)
        peer = about[1] if about else "?"
        self.ledger.received(peer, "reply", len(payload))
        try:
            if about is None:
                raise WireError(robot=peer, size_bytes=len(payload), reason="late")
            author, epoch = about[0]
            message = envelope.decode(payload, robot=peer)
            if epoch == LIST and isinstance(message, RevisionList):
                self._on_list(peer, message, now_s)
            elif epoch != LIST and isinstance(message, Record | SnapshotChunk) and message.epoch == epoch:
                self._on_revision(author, message, payload, now_s)
            else:
                raise WireError(robot=peer, size_bytes=len(payload), reason="not what was asked")
        except WireError as error:
            self.ledger.dropped(peer, "reply", len(payload), reason=_short(error))
        self._ask_due(now_s)

    def on_reply_end(self, ask_id: int, *, now_s: float) -> None:
        """No more replies to an ``Ask`` will come."""
        self._catchup.ended(ask_id, now_s)

    def tick(self, now_s: float) -> None:
        """Send the heartbeat and the questions that are due. Call it some ten times a second."""
        if now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = now_s + self._heartbeat_s
            heartbeat = Heartbeat(self.own.epoch, self.own.seq, self.holdings.held_hash())
            self._put("digest", envelope.encode(heartbeat))
        if self._waiting and self._quota.may_send(now_s):
            try:
                self.send_waiting(now_s)
            except ConfigError as error:  # who published it is told at the next call
                self._refused = error
        self._ask_due(now_s)

    def take_outputs(self) -> list[Output]:
        """What came out since the last call, in order."""
        outputs, self._outputs = self._outputs, []
        return outputs

    # What is known

    def ask_list(self, robot: str, *, now_s: float) -> None:
        """Ask a living peer which revisions it holds."""
        self._listed.discard(robot)
        self._catchup.want((robot, LIST), now_s)

    def lacking(self) -> list[str]:
        """What is still missing of what living peers hold, in words; empty when this robot is in step."""
        unlisted = [f"the list of {robot}" for robot in sorted(self.alive) if robot not in self._listed]
        behind = [key for key in self._catchup.announced_keys() if self._behind(key)]
        return unlisted + [f"{robot} epoch {epoch}" for robot, epoch in behind]

    # How it works

    def _check_reach(
        self, *, header: Header | None = None, submaps: Mapping[str, Submap], submap: str | None = None
    ) -> None:
        after = replace(self.own, header=header or self.own.header, submaps=submaps)
        check_reach(self.own, after, self.holdings.streams(), submap=submap)

    def _commit(self, *, header: Header | None = None, submaps: Mapping[str, Submap] | None = None) -> bool:
        old = self.own
        record = self.author.commit(header=header, submaps=submaps)
        if record is None:
            return False
        self._put("delta", record)
        self._said_bytes = len(record)
        self._outputs.extend(changed_events(old, self.own))
        return True

    def _say(self, suffix: str, payload: bytes) -> None:
        """Publish something that is said again to every robot that appears."""
        self._said[suffix] = payload
        self._put(suffix, payload)

    def _put(self, suffix: str, payload: bytes) -> None:
        self.ledger.sent(suffix, len(payload))
        self._outputs.append(Put(suffix, payload))

    def _on_message(self, robot: str, suffix: str, raw: bytes, message: Message, now_s: float) -> None:
        match suffix, message:
            case "delta", Record():
                self._on_revision(robot, message, raw, now_s)
            case "digest", Heartbeat(epoch, seq, held):
                self._announced((robot, epoch), seq, robot, now_s + GRACE_S)
                self._compare_held(robot, held, now_s)
            case ("pose", PoseMessage() as said) | ("goal", GoalMessage() as said):
                self.teammates.hear(robot, said, now_s)
            case _:
                raise WireError(robot=robot, size_bytes=len(raw), reason="wrong key")

    def _on_revision(self, robot: str, message: Record | SnapshotChunk, raw: bytes, now_s: float) -> None:
        """A record or a part of a snapshot, by whatever way it came."""
        key = (robot, message.epoch)
        if message.seq == 0 or not self.holdings.keeps(key):
            raise WireError(robot=robot, size_bytes=len(raw), reason="stream not kept")
        if key not in self.holdings.replicas:
            self.holdings.replicas[key] = Replica(Stream(*key))
            # Now, and not when a record fits: one that never does would keep the place.
            self._dropped(self.holdings.drop_oldest(robot))
        replica = self.holdings.replicas[key]
        before = replica.stream
        outcome = replica.offer(message, raw) if isinstance(message, Record) else replica.offer_chunk(message)
        if outcome is Outcome.APPLIED:
            self._outputs.extend(changed_events(before, replica.stream))
            if robot not in self.alive and before.seq > 0:
                self._outputs.append(Detour(robot))
            if before.header != replica.stream.header:
                self._drop_revoked()
            if not self._behind(key):
                self._catchup.settled(key)
        elif outcome is not Outcome.DUPLICATE and isinstance(message, Record):
            due_s = now_s if outcome is Outcome.REFUSED else now_s + GRACE_S
            self._announced(key, message.seq, robot, due_s)
        if outcome in (Outcome.DUPLICATE, Outcome.REFUSED):
            raise WireError(robot=robot, size_bytes=len(raw), reason=outcome.value)

    def _on_list(self, peer: str, message: RevisionList, now_s: float) -> None:
        self._listed.add(peer)
        self._catchup.settled((peer, LIST))
        self._catchup.forget_announced(peer)
        for robot, revision in message.revisions:
            if robot == self.robot and not self._is_older_life(revision):
                if revision.epoch < CLAIMED_EPOCHS:
                    self._restart(revision.epoch + 1)
            elif (robot, revision.epoch) != (self.robot, self.own.epoch):
                self._announced((robot, revision.epoch), revision.seq, peer, now_s, digest=revision.digest)

    def _is_older_life(self, revision: Revision) -> bool:
        """Whether the own name can have had this revision: in an earlier epoch, or in this one."""
        if revision.epoch != self.own.epoch:
            return revision.epoch < self.own.epoch
        return revision.seq < self.own.seq or revision == self.own.revision

    def _restart(self, epoch: int) -> None:
        """Go on under a new epoch: someone holds a stream of this name that the own one can't follow."""
        record = self.author.restart(epoch)
        self._outputs.append(EpochChanged(epoch))
        if record is not None:
            self._put("delta", record)
        self._outputs.extend(changed_events(Stream(self.robot, epoch), self.own))
        self._drop_revoked()

    def _announced(self, key: Key, seq: int, holder: str, due_s: float, *, digest: int | None = None) -> None:
        """``holder`` says that it holds this much; ask for it at ``due_s`` if that is news then."""
        if seq == 0 or not self.holdings.keeps(key):
            return
        replica = self.holdings.replicas.get(key)
        if holder == key[0] and digest is not None and replica and seq == replica.stream.seq:
            replica.suspect |= digest != replica.stream.digest
        lives = {epoch for epoch, _ in self.alive.get(holder, ())}
        # A late word of an author's earlier life: only a list says whether that robot still holds it.
        if lives and (holder != key[0] or digest is not None or key[1] in lives):
            self._catchup.announced(key, holder, seq)
        if self._behind(key):
            self._catchup.want(key, due_s)

    def _behind(self, key: Key) -> bool:
        return bool(self._catchup.ahead(key, self.holdings.held_seq(key)))

    def _drop_revoked(self) -> None:
        self._dropped(self.holdings.drop_revoked())
        revoked = self.holdings.revoked().get(self.robot, -1)
        if revoked >= self.own.epoch:
            self._restart(revoked + 1)

    def _dropped(self, streams: Iterable[Stream]) -> None:
        for stream in streams:
            self._catchup.stream_gone((stream.robot, stream.epoch))
            self._outputs.append(Changed((stream.robot, stream.epoch, ""), None, 0, stream.edges, stream.revision))

    def _compare_held(self, robot: str, held: int, now_s: float) -> None:
        """Ask for a peer's list when two heartbeats in a row differ from an unchanged own hash."""
        seen = (held, self.holdings.held_hash())
        if held == seen[1]:
            self._mismatch.pop(robot, None)
        elif robot in self.alive and self._mismatch.get(robot) == seen:
            self.ask_list(robot, now_s=now_s)
        elif robot in self.alive:
            self._mismatch[robot] = seen

    def _ask_due(self, now_s: float) -> None:
        for key, attempt in self._catchup.due(now_s):
            robot, epoch = key
            if epoch == LIST:
                peer, suffix, payload = robot, "revisions", b""
            else:
                peers = self._catchup.ahead(key, self.holdings.held_seq(key))
                if not peers:
                    self._catchup.settled(key)
                    continue
                peer = peers[attempt % len(peers)]
                suffix = "snapshot" if peer == robot else f"mirror/{robot}"
                replica = self.holdings.replicas.get(key)
                payload = envelope.encode(Want(replica.held if replica else Revision(epoch, 0, 0)))
            self.ledger.sent("want", len(payload))
            self._outputs.append(Ask(self._catchup.sent(key, peer, now_s), peer, suffix, payload))

    def _answer(self, suffix: str, payload: bytes, robot: str) -> list[bytes]:
        if suffix == "revisions":
            revisions = tuple((s.robot, s.revision) for s in self.holdings.streams())
            return [envelope.encode(RevisionList(revisions))]
        want = envelope.decode(payload, robot=robot)
        if not isinstance(want, Want):
            raise WireError(robot=robot, size_bytes=len(payload), reason="not a question")
        kind, _, author = suffix.partition("/")
        if kind == "snapshot" and want.revision.epoch == self.own.epoch:
            return answer(self.own, self.author.log, want.revision)
        replica = self.holdings.replicas.get((author if kind == "mirror" else self.robot, want.revision.epoch))
        if replica is None or replica.suspect:
            raise WireError(robot=robot, size_bytes=len(payload), reason="stream not held")
        return answer(replica.stream, replica.log, want.revision)


def _millimetres(option: str, point_xy: tuple[float, float]) -> tuple[int, int]:
    if not all(math.isfinite(v) and abs(v) * 1e3 <= MAX_MM for v in point_xy):
        raise ConfigError(
            option=option, value=point_xy, reason=f"expected finite numbers of at most {MAX_MM // 1000} m"
        )
    return round(point_xy[0] * 1e3), round(point_xy[1] * 1e3)


def _short(error: WireError | ConfigError) -> str:
    """A refusal's reason without its numbers, so that there are few of them to count."""
    return "".join(c for c in error.reason if not c.isdigit())[:40]
