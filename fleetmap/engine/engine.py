"""The engine: what the link delivers and times go in, things for the link to do and events come out.

No I/O, no thread, no clock, no randomness. An author numbers its revisions, and a record leads from one to the next.
Who finds a gap, hears a heartbeat that is ahead, or meets a peer for the first time, asks: the author, or any peer that
mirrors it. Nothing that comes from the network raises; what is refused is counted by the name that it claims, kind and
reason.

    record  ->  next one of a life?  ->  applied, told to the user
                not yet              ->  ask the author, or who holds more   ->  records, or a snapshot
    heartbeat or list says that somebody holds more, or something else       ->  ask
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Collection, Iterable, Mapping

from fleetmap.accounting import Ledger
from fleetmap.codecs import envelope
from fleetmap.codecs.facts import FactsStep, forget, name_lives, set_anchor, set_level, set_start, supersede
from fleetmap.codecs.messages import (
    MAX_EPSILON_CELLS,
    MAX_MM,
    PROFILES,
    GoalMessage,
    Heartbeat,
    PoseMessage,
    Record,
    Revision,
    RevisionList,
    SnapshotChunk,
    Want,
)
from fleetmap.codecs.names import NAME, check_name
from fleetmap.engine.author import Author
from fleetmap.engine.budget import Budget, Budgets
from fleetmap.engine.catchup import FIRST_REPLY_TIMEOUT_S, GRACE_S, REPLY_TIMEOUT_S, About, Catchup
from fleetmap.engine.chain import Chain
from fleetmap.engine.changes import changed_events, gone_event, no_edge_changed
from fleetmap.engine.holdings import Holdings
from fleetmap.engine.inputs import Alive, Gone, Input, Message, Query, Reply, ReplyEnd
from fleetmap.engine.log import Snapshots, answer
from fleetmap.engine.neighbours import Neighbour, Neighbours
from fleetmap.engine.outputs import Answer, Ask, Detour, LifeChanged, LookAgain, Output, PeersChanged, Put
from fleetmap.engine.quota import Quota
from fleetmap.engine.reach import check_reach
from fleetmap.engine.replica import Outcome, Replica
from fleetmap.engine.stream import Key, Limits, Step, Stream
from fleetmap.engine.teammates import Teammates
from fleetmap.engine.votes import contradictions, most_held
from fleetmap.model.density import check_density
from fleetmap.model.errors import ConfigError, WireError
from fleetmap.model.pose import FixedPose, wrap
from fleetmap.model.vectormap import VectorMap

CONTEST_S = 1.0
"""At least so long between two words that are said only because somebody spoke in this robot's name."""
STAGGER_S, LONGEST_STAGGER_S = 0.3, 1.2
"""Between the questions for lists that several tokens at once lead to."""
RELIST_S = 1.0
"""After so long a list is asked for anew that promised what its sender then didn't have."""
WORK_BPS, WORK_BURST_BYTES, WORKERS = 256 << 10, 8 << 20, 2048
"""What one name may have a peer decode. A snapshot is 4 MB at most; what is refused counts sixteenfold."""
REFUSED_COUNTS = 16
ANSWER_BPS, ANSWER_BURST_BYTES = 4 << 20, 32 << 20
"""What a peer sends in answers, all together."""


class Engine:
    """One robot's side of the exchange.

    Parameters
    ----------
    robot : own name
    chain : the links of the own life
    level : robots of different levels are never merged
    start : T_fleet_robot, None if unknown
    heartbeat_s : how often the own revision is announced
    quota : when updates of the own map may be sent; None: at once
    allow : names that are listened to; None: all
    limits : what one robot's map may hold
    """

    def __init__(
        self,
        robot: str,
        *,
        chain: Chain,
        level: str = "0",
        start: FixedPose | None = None,
        heartbeat_s: float = 2.0,
        quota: Quota | None = None,
        ledger: Ledger | None = None,
        allow: Collection[str] | None = None,
        limits: Limits | None = None,
    ) -> None:
        self.robot = check_name("robot", robot)
        self.ledger = ledger or Ledger()
        self.author = Author(robot, chain)
        self.holdings = Holdings(self.author)
        self.neighbours = Neighbours()
        self.teammates = Teammates()
        self._allow = None if allow is None else {robot, *(check_name("allow", name) for name in allow)}
        self._limits = limits or Limits()
        self._heartbeat_s, self._heartbeat_due_s = heartbeat_s, 0.0
        self._catchup, self._snapshots = Catchup(), Snapshots()
        self._work = Budgets(WORK_BPS, WORK_BURST_BYTES, names=WORKERS)
        self._answers = Budget(ANSWER_BPS, ANSWER_BURST_BYTES)
        self._quota = quota or Quota()
        self._waiting_maps: dict[str, VectorMap] = {}
        self._waiting_facts: FactsStep = {}
        self._said_bytes = 0
        self._refused: ConfigError | None = None
        self._said: dict[str, bytes] = {}
        self._listed: tuple[int, dict[Key, Revision]] = (-1, {})
        self._contested_s = -math.inf
        self._contest = False
        self._outputs: list[Output] = []
        self._left_out: set[Key] = set()
        self._commit(facts={**set_level(level), **set_start(start)}, even_if_nothing=True)

    @property
    def own(self) -> Stream:
        """What this robot has said."""
        return self.author.stream

    # What the user says

    def publish(
        self,
        submap: str,
        vector_map: VectorMap,
        *,
        anchor: FixedPose | None = None,
        supersedes: bool = False,
        now_s: float = 0.0,
    ) -> bool:
        """Say what a submap is now, or, if the quota doesn't allow it yet, as soon as it does.

        What is said then is the difference to what was said last: what came between is never sent. With ``supersedes``
        the own former lives that are held end with it. False if nothing changed, and nothing is to be sent.

        Raises
        ------
        ConfigError : the name or the profile is none; the map has too many edges, in all or in one place, or is too far
            from others of the component (``engine.reach``); or the whole map (or the one before, if it had to wait)
            grew beyond what a snapshot may hold
        """
        if self._refused is not None:
            refused, self._refused = self._refused, None
            raise refused
        check_name("submap", submap)
        if vector_map.profile not in PROFILES or not 0 <= vector_map.epsilon_cells <= MAX_EPSILON_CELLS:
            told = (vector_map.profile, vector_map.epsilon_cells)
            raise ConfigError(option="map", value=told, reason=f"expected {PROFILES} and at most {MAX_EPSILON_CELLS}")
        maps = {**self._waiting_maps, submap: vector_map}
        self._check_density(maps, submap)
        facts = {**self._waiting_facts, **set_anchor(submap, anchor or FixedPose())}
        if supersedes:
            facts |= self._supersede_former()
        self._check_reach(facts, maps, submap=submap)
        self._waiting_maps, self._waiting_facts = maps, facts
        if self._quota.may_send(now_s):
            return self.send_waiting(now_s)
        return self._after(facts, maps).digest != self.own.digest

    def send_waiting(self, now_s: float) -> bool:
        """Say what waits for the quota, whether or not it allows it; False if that is nothing."""
        maps, self._waiting_maps = self._waiting_maps, {}
        facts, self._waiting_facts = self._waiting_facts, {}
        if not maps or not self._commit(facts=facts, submaps={**self.own.submaps, **maps}):
            return False
        self._quota.sent(self._said_bytes, now_s)
        return True

    def set_start(self, start: FixedPose | None) -> bool:
        """Say where the own map frame lies in the fleet's.

        Raises
        ------
        ConfigError : the own maps would lie too far from others of the component (``engine.reach``)
        """
        facts = set_start(start)
        self._check_reach({**self._waiting_facts, **facts}, self._waiting_maps)
        return self._commit(facts=facts)

    def forget(self, robot: str, *, everywhere: bool = False) -> bool:
        """Leave what a robot has said so far out of the merged map: here, or at every peer. What it says next is back.

        Of the own name: end the former lives, at every peer.

        Raises
        ------
        ConfigError : no stream of that robot is held
        """
        check_name("robot", robot)
        if robot == self.robot:
            step = self._supersede_former()
            if not step:
                raise ConfigError(option="robot", value=robot, reason="no former life of this robot is held")
            self._commit(facts=step)
            return True
        streams = {s.key: s.state for s in self.holdings.streams() if s.robot == robot}
        if not streams:
            raise ConfigError(option="robot", value=robot, reason="no map of that robot is held")
        before = self.left_out()
        if everywhere:
            self._commit(facts=forget(streams))
        else:
            self.holdings.hidden.update(streams)
        self._tell_left_out(before)
        return self.left_out() != before

    def set_pose(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """Announce where the robot is, in its map frame.

        Raises
        ------
        ConfigError : a number is not finite, or too large
        """
        x_mm, y_mm = _millimetres("pose", (x_m, y_m))
        yaw_mrad = round(wrap(yaw_rad) * 1e3)
        self._say("pose", envelope.encode(PoseMessage(x_mm, y_mm, yaw_mrad)))

    def set_goal(self, goal_xy: tuple[float, float] | None) -> None:
        """Announce where the robot is going, in its map frame; None: nowhere.

        Raises
        ------
        ConfigError : a number is not finite, or too large
        """
        goal_mm = None if goal_xy is None else _millimetres("goal", goal_xy)
        self._say("goal", envelope.encode(GoalMessage(goal_mm)))

    # What the link says

    def receive(self, item: Input, *, now_s: float) -> None:
        """Take what the link delivered. ``take_outputs`` gives what came of it."""
        self.holdings.now_s = now_s
        match item:
            case Message(robot, life, kind, payload):
                self._count(robot, kind, payload, lambda: self._on_message((robot, life), kind, payload, now_s))
            case Alive(robot, life):
                self._on_alive((robot, life), now_s)
                return  # the next tick asks: thousands of tokens may come at once
            case Gone(robot, life):
                self._on_gone((robot, life))
            case Query(kind, payload, reply):
                self._outputs.append(Answer(reply, tuple(self._on_query(kind, payload, now_s))))
            case Reply(ask_id, payload):
                about = self._catchup.about(ask_id)
                name = about.peer[0] if about else "?"
                self._count(name, "reply", payload, lambda: self._on_reply(ask_id, about, payload, now_s))
            case ReplyEnd(ask_id):
                self._in_vain(self._catchup.ended(ask_id, now_s), now_s)
        self._ask_due(now_s)

    def tick(self, now_s: float) -> None:
        """Send the heartbeat and the questions that are due. Call it some ten times a second."""
        self.holdings.now_s = now_s
        if now_s >= self._heartbeat_due_s:
            self._heartbeat_due_s = now_s + self._heartbeat_s
            self._put("digest", envelope.encode(Heartbeat(self.own.seq, self.holdings.held_hash())))
        if self._waiting_maps and self._quota.may_send(now_s):
            try:
                self.send_waiting(now_s)
            except ConfigError as error:  # who published it is told at the next call
                self._refused = error
        for robot in sorted(self.holdings.undecided):
            self._settle(robot)
        # Who was spared for a while may have to go now.
        before, self._left_out = self._left_out, self.left_out()
        if before != self._left_out:
            self._tell_left_out(before)
        if self._contest and now_s >= self._contested_s + CONTEST_S:
            self._contest, self._contested_s = False, now_s
            self._commit(even_if_nothing=True)
        self._ask_due(now_s)

    def take_outputs(self) -> list[Output]:
        """What came out since the last call, in order. To be called after each of the others."""
        outputs, self._outputs = self._outputs, []
        return outputs

    # What is known

    def ask_lists(self, *, now_s: float) -> None:
        """Ask all that are there what they hold."""
        for key, neighbour in self.neighbours.by_key.items():
            neighbour.listed = False
            self._catchup.want_list(key, now_s)

    def lacking(self) -> list[str]:
        """What is still missing of what living peers hold, in words; empty when this robot is in step."""
        unlisted = [n.key for n in self.neighbours.by_key.values() if not n.listed and not n.mute]
        waited = [key for key in sorted(self._claimed_streams()) if self._behind(key, waiting=True)]
        return [
            *(f"the list of {robot}" for robot, _ in sorted(unlisted)),
            *(f"{robot} life {life:016x}" for robot, life in waited),
            *(f"{text}; forget({robot!r}) leaves it out" for robot, text in sorted(self.disputed().items())),
        ]

    def left_out(self) -> set[Key]:
        """Streams that are kept and not merged."""
        return self.holdings.left_out(self._present)

    def disputed(self) -> dict[str, str]:
        """Robots whose maps the others don't agree about, and who says what; those that are left out don't count."""
        left_out = self.left_out()
        told: dict[str, str] = {}
        for replica in self.holdings.replicas.values():
            stream = replica.stream
            if not replica.kept or stream.seq == 0 or stream.key in left_out:
                continue
            life = f"{stream.robot} life {stream.life:016x} seq {stream.seq}"
            if replica.forked:
                told[stream.robot] = f"{life} is disputed: its author has said two things; its next word decides"
            elif stream.key not in self.neighbours:
                claims = self.neighbours.holders(stream.key)
                if sides := contradictions(claims, stream.revision, self.robot):
                    who = "; ".join(f"{', '.join(names)}: digest {digest:016x}" for digest, names in sides.items())
                    told[stream.robot] = f"{life} is disputed: its author is absent, and {who}"
        return told

    # How it works: what is heard

    def _on_message(self, key: Key, kind: str, payload: bytes, now_s: float) -> None:
        robot, _ = key
        self._check_allowed(robot, payload)
        if kind == "delta":
            payer = self._payer(key, payload)
            if payer.left(now_s) <= 0:
                raise WireError(robot=robot, size_bytes=len(payload), reason="claimed: too much work")
            payer.spend(len(payload))
        message = envelope.decode(payload, robot=robot)
        if key == self.own.key:
            self._on_own_word(message, payload)
            return
        if self.neighbours.waits(key):
            self._on_alive(key, now_s)
        neighbour = self.neighbours.by_key.get(key)
        match kind, message:
            case "delta", Record():
                self._on_words(key, message, payload, now_s, speaker=key)
            case "digest", Heartbeat():
                if neighbour is not None:
                    self._on_heartbeat(neighbour, message, now_s)
            case ("pose", PoseMessage() as said) | ("goal", GoalMessage() as said):
                self.teammates.hear(key, said, now_s)
            case _:
                raise WireError(robot=robot, size_bytes=len(payload), reason="wrong key")
        if neighbour is not None:
            self._spoke(neighbour)

    def _on_heartbeat(self, neighbour: Neighbour, message: Heartbeat, now_s: float, *, asked: bool = False) -> None:
        key, own_hash = neighbour.key, self.holdings.held_hash()
        if message.held == own_hash:
            # It holds what is held here, whatever its last list said.
            neighbour.claims, neighbour.listed = self._own_claims(own_hash), True
        self._claims(neighbour, key, Revision(key[1], message.seq, 0), now_s + GRACE_S, now_s)
        if asked and message.held != own_hash:
            # It answered that it holds the same; meanwhile something was said.
            self._catchup.want_list(key, now_s + GRACE_S)
        elif not asked and neighbour.differs(message.held, own_hash, now_s):
            neighbour.listed = False
            self._catchup.want_list(key, now_s)

    def _on_own_word(self, message: object, payload: bytes) -> None:
        """Somebody speaks in this life's name: a stranger, or a copy of this process' memory or disk."""
        if isinstance(message, Record) and message.seq <= self.author.chain.revisions:
            own = self.own.revision
            genuine = message.link == self.author.chain.link(message.seq)
            if genuine and (message.seq > own.seq or (message.seq == own.seq and message.check != own.check)):
                self.author.skip_to(message.seq)
                self._contest = True
        raise WireError(robot=self.robot, size_bytes=len(payload), reason="claimed: the own life")

    def _on_words(
        self, key: Key, message: Record | SnapshotChunk, raw: bytes, now_s: float, *, speaker: Key
    ) -> Outcome:
        """A record or a part of a snapshot, by whatever way it came: from its author, or from a mirror."""
        robot, by_author = key[0], speaker == key
        replica = self.holdings.replicas.get(key)
        known = replica is not None
        if replica is None:
            # Kept only once it has said something that holds: who invents streams fills no table.
            replica = Replica(Stream(*key))
        target = self._most_held(self.neighbours.holders(key), replica)
        try:
            if isinstance(message, Record):
                outcome = replica.offer(message, raw, self._limits, by_author=by_author)
            else:
                outcome = replica.offer_chunk(message, self._limits, by_author=by_author, instead=target)
        except WireError as error:
            if not error.reason.startswith("claimed"):
                # Decoded, and in vain: the author's words don't fit what is held, or a mirror lies.
                self._budget(speaker).spend(REFUSED_COUNTS * len(raw))
                if by_author:
                    self._announced(key, message.seq, now_s)
            raise
        if not known and (replica.stream.seq > 0 or not isinstance(message, Record)):
            self.holdings.replicas[key] = replica
            self._dropped(self.holdings.find_room(self._present, newcomer=key))
        for step in replica.take_steps():
            self._moved(step)
        match outcome:
            case Outcome.APPLIED:
                if not by_author and robot not in self.neighbours.robots():
                    self._note_detour(replica)
                if not self._behind(key):
                    self._catchup.settled(key)
            case Outcome.EARLY:
                if isinstance(message, Record) and by_author:
                    self._announced(key, message.seq, now_s + GRACE_S)
                if lost := self.holdings.bound_waiting():
                    self.ledger.dropped(robot, "early", lost, reason="no room")
            case Outcome.FORKED:
                raise WireError(robot=robot, size_bytes=len(raw), reason="claimed: other bytes under the same seq")
            case Outcome.DUPLICATE:
                raise WireError(robot=robot, size_bytes=len(raw), reason="duplicate")
        return outcome

    def _note_detour(self, replica: Replica) -> None:
        """The stream of a robot that seems absent came through a mirror: see whether anybody hears that robot now.

        If the others hold more than they did when its stream last came. What they held then was perhaps its last word,
        and may come in many parts.
        """
        claims = self.neighbours.holders(replica.key).values()
        last = max((revision.seq for revision in claims), default=replica.stream.seq)
        if replica.last_claimed and last > replica.last_claimed:
            self._outputs.append(Detour(replica.stream.robot))
        replica.last_claimed = last

    def _moved(self, step: Step) -> None:
        """A replica has taken a step."""
        robot = step.after.robot
        # A step with facts may leave other streams out, or bring them back.
        facts_changed = step.before.facts != step.after.facts
        self._outputs.extend(changed_events(step))
        self._settle(robot)
        if facts_changed:
            if step.after.forgets.get(self.own.key) == self.own.state:
                self._contest = True  # whoever lives is in the map
            if step.after.robot == self.robot and step.after.supersedes.get(self.own.life) == self.own.state:
                self._contest = True

    def _on_list(self, neighbour: Neighbour, message: RevisionList, now_s: float) -> None:
        claims: dict[Key, Revision] = {}
        for robot, revision in message.revisions:
            key = (robot, revision.life)
            if revision.seq > 0 and (self._allow is None or robot in self._allow):
                claims[key] = revision
        before = neighbour.claims
        self.neighbours.say(neighbour, claims)
        self._catchup.listed(neighbour.key, neighbour.claims)
        for key, revision in claims.items():
            if key == self.own.key:
                self._on_own_row(neighbour, revision, now_s)
                continue
            if before.get(key) != revision:
                self._catchup.renewed(About(neighbour.key, key), now_s)
            if self._behind(key):
                # Of an absent author the others may say something else: their lists come first.
                known = key in self.neighbours or key in self.holdings.replicas
                self._catchup.want(key, now_s if known else now_s + GRACE_S)

    def _on_own_row(self, neighbour: Neighbour, revision: Revision, now_s: float) -> None:
        """A peer holds another state of the own life than is held here: perhaps this life has come to it."""
        own = self.own.revision
        if revision.seq == own.seq and revision.digest != own.digest:
            self._contest = True
        elif own.seq < revision.seq <= self.author.chain.revisions:
            self._catchup.want(self.own.key, now_s)

    def _on_reply(self, ask_id: int, about: About | None, payload: bytes, now_s: float) -> None:
        if about is None:
            raise WireError(robot="?", size_bytes=len(payload), reason="late")
        name = about.peer[0]
        neighbour = self.neighbours.by_key.get(about.peer)
        if about.stream is not None:
            self._check_work(about.peer, payload, now_s)
        message = envelope.decode(payload, robot=name)
        if about.stream is None and isinstance(message, RevisionList) and neighbour is not None:
            self._catchup.helped(ask_id, now_s)
            self._spoke(neighbour)
            self._on_list(neighbour, message, now_s)
        elif about.stream is None and isinstance(message, Heartbeat) and neighbour is not None:
            self._catchup.helped(ask_id, now_s)
            self._spoke(neighbour)
            self._on_heartbeat(neighbour, message, now_s, asked=True)
        elif about.stream is not None and isinstance(message, Record | SnapshotChunk):
            if about.stream == self.own.key:
                self._on_own_proof(message)
                return
            self._on_words(about.stream, message, payload, now_s, speaker=about.peer)
            self._catchup.helped(ask_id, now_s)
            if neighbour is not None:
                self._spoke(neighbour)
        else:
            raise WireError(robot=name, size_bytes=len(payload), reason="not what was asked")

    def _on_own_proof(self, message: Record | SnapshotChunk) -> None:
        """What a peer holds of the own life: if its link is right, this life has said it, and goes on behind it."""
        chain, seq = self.author.chain, message.seq
        if self.own.seq < seq <= chain.revisions and message.link == chain.link(seq):
            self.author.skip_to(seq)
            self._contest = True
        self._catchup.settled(self.own.key)

    def _in_vain(self, about: About | None, now_s: float) -> None:
        """A question was not answered."""
        neighbour = None if about is None else self.neighbours.by_key.get(about.peer)
        if about is None or neighbour is None:
            return
        if about.stream is None:
            neighbour.unanswered += 1
            if not neighbour.listed:
                self._catchup.want_list(neighbour.key, now_s)
        elif not self._catchup.in_vain(about):
            # Perhaps it has dropped the stream since it said that it holds it.
            neighbour.listed = False
            self._catchup.want_list(neighbour.key, now_s + RELIST_S)

    # How it works: who is there

    def _on_alive(self, key: Key, now_s: float) -> None:
        robot, _ = key
        if key == self.own.key:
            return
        if not NAME.fullmatch(robot) or (self._allow is not None and robot not in self._allow):
            self.ledger.dropped(robot, "alive", 0, reason="claimed: not allowed")
            return
        neighbour = self.neighbours.add(key)
        for silent in self.neighbours.evicted:
            self._catchup.peer_gone(silent)
        self.neighbours.evicted.clear()
        if neighbour is None:
            self.ledger.dropped(robot, "alive", 0, reason="too_many_peers")
            return
        # One after the other: when the first has been listened to, most of the others hold the same.
        self._catchup.want_list(key, now_s + min(STAGGER_S * self._catchup.lists_waiting, LONGEST_STAGGER_S))
        self._settle(robot)

    def _on_gone(self, key: Key) -> None:
        """Its map stays, and it is absent."""
        robot, _ = key
        neighbour = self.neighbours.remove(key)
        if neighbour is None:
            return
        self._catchup.peer_gone(key)
        if neighbour.spoke and robot not in self.neighbours.robots():
            self.teammates.gone(robot)
            self._outputs.append(PeersChanged(robot, False))
        self._settle(robot)
        if self.neighbours.refused:
            self.neighbours.refused = False
            self._outputs.append(LookAgain())

    def _spoke(self, neighbour: Neighbour) -> None:
        neighbour.unanswered = 0
        if neighbour.spoke:
            return
        robot = neighbour.key[0]
        new = robot not in self.neighbours.robots()
        neighbour.spoke = True
        for kind, payload in self._said.items():
            self._put(kind, payload)
        if new:
            self._outputs.append(PeersChanged(robot, True))

    # How it works: what is missing

    def _claims(self, neighbour: Neighbour, key: Key, revision: Revision, due_s: float, now_s: float) -> None:
        """An author says how far it is; its digest isn't said, and not asked for as long as the seq is right."""
        known = neighbour.claims.get(key)
        if known is None or known.seq != revision.seq:
            neighbour.claims = {**neighbour.claims, key: revision}
            self._catchup.renewed(About(neighbour.key, key), now_s)
        if self._behind(key):
            self._catchup.want(key, due_s)

    def _own_claims(self, held: int) -> dict[Key, Revision]:
        """What a list of this peer would say; one for all neighbours that hold the same."""
        if self._listed[0] != held:
            self._listed = (held, {s.key: s.revision for s in self.holdings.streams()})
        return self._listed[1]

    def _announced(self, key: Key, seq: int, due_s: float) -> None:
        """An author's word that can't be used yet shows that there is more."""
        neighbour = self.neighbours.by_key.get(key)
        if neighbour is not None:
            known = neighbour.claims.get(key)
            if known is None or known.seq < seq:
                neighbour.claims = {**neighbour.claims, key: Revision(key[1], seq, 0)}
            self._catchup.want(key, due_s)

    def _coming(self, key: Key) -> bool:
        """Whether more of a stream can be expected."""
        return self._behind(key, waiting=True)

    def _claimed_streams(self) -> set[Key]:
        return {key for n in self.neighbours.by_key.values() for key in n.claims}

    def _behind(self, key: Key, *, waiting: bool = False) -> bool:
        return bool(self._holders(key, waiting=waiting))

    def _holders(self, key: Key, *, waiting: bool = False) -> list[Key]:
        """Whom to ask about a stream, in the order of preference: its author, then who holds what most names hold.

        Parameters
        ----------
        waiting : leave out those that were asked in vain
        """
        claims = self.neighbours.holders(key)
        if waiting:
            claims = {peer: r for peer, r in claims.items() if not self._catchup.in_vain(About(peer, key))}
        if key == self.own.key:
            return sorted(peer for peer, revision in claims.items() if revision.seq > self.own.seq and not waiting)
        held, replica = self.holdings.revision(key), self.holdings.replicas.get(key)
        peers = [peer for peer, r in claims.items() if r.seq > held.seq and not self.holdings.was_dropped(key, r)]
        if key in self.neighbours:
            said = claims.get(key)
            # Its own list says other bytes than are held: once for each seq that may set them right.
            other = said is not None and said.digest and said.seq == held.seq and said.digest != held.digest
            if other and replica is not None and not replica.corrected:
                peers.append(key)
        elif replica is not None and not replica.heard and not peers:
            best = self._most_held(claims, replica)
            if best is not None and best.seq == held.seq and best.digest != held.digest:
                peers = [peer for peer, revision in claims.items() if revision == best]
        return sorted(peers, key=lambda peer: (peer != key, -claims[peer].seq, peer))

    def _most_held(self, claims: dict[Key, Revision], replica: Replica) -> Revision | None:
        """What to believe of an absent author.

        What is held here only because somebody was the first to offer it is no vote, until it was outvoted once: from
        then on it is, or two peers would change sides for ever.
        """
        return most_held({**claims, self.own.key: replica.stream.revision} if replica.outvoted else claims)

    def _ask_due(self, now_s: float) -> None:
        for about in self._catchup.expired(now_s):
            self._in_vain(about, now_s)
        for about in self._catchup.due(now_s, self._holders, self._present):
            robot, life = about.peer
            if about.stream is None:
                # Who holds the same says so, and no list.
                kind, payload = "revisions", envelope.encode(Heartbeat(self.own.seq, self.holdings.held_hash()))
            else:
                kind = "snapshot" if about.peer == about.stream else "mirror"
                if about.stream == self.own.key:
                    want = Want(self.robot, self.own.revision)
                else:
                    replica = self.holdings.replicas.get(about.stream)
                    name, other = about.stream
                    want = replica.want() if replica is not None else Want(name, Revision(other, 0, 0))
                payload = envelope.encode(want)
            self.ledger.sent("want", len(payload))
            timeout_s = REPLY_TIMEOUT_S if self._present(about.peer) else FIRST_REPLY_TIMEOUT_S
            ask_id = self._catchup.sent(about, now_s, timeout_s=timeout_s)
            self._outputs.append(Ask(ask_id, robot, life, kind, payload))

    # How it works: what is answered

    def _on_query(self, kind: str, payload: bytes, now_s: float) -> list[bytes]:
        self.ledger.received("?", f"{kind}?", len(payload))
        try:
            replies = self._answer(kind, payload)
            if self._answers.left(now_s) <= 0:
                raise WireError(robot="?", size_bytes=len(payload), reason="too many questions")
        except (WireError, ConfigError) as error:
            self.ledger.dropped("?", f"{kind}?", len(payload), reason=_short(error))
            return []
        for reply in replies:
            self._answers.spend(len(reply))
            self.ledger.sent("list" if kind == "revisions" else "repair", len(reply))
        return replies

    def _answer(self, kind: str, payload: bytes) -> list[bytes]:
        if kind == "revisions":
            asked = envelope.decode(payload, robot="?") if payload else None
            own_hash = self.holdings.held_hash()
            if isinstance(asked, Heartbeat) and asked.held == own_hash:
                return [envelope.encode(Heartbeat(self.own.seq, own_hash))]
            return [envelope.encode(RevisionList(tuple((s.robot, s.revision) for s in self.holdings.streams())))]
        want = envelope.decode(payload, robot="?")
        if not isinstance(want, Want):
            raise WireError(robot="?", size_bytes=len(payload), reason="not a question")
        key = (want.robot, want.revision.life)
        if key == self.own.key:
            return answer(self.own, self.author.log, want, self._snapshots)
        replica = self.holdings.replicas.get(key)
        if replica is None or not replica.kept:
            raise WireError(robot="?", size_bytes=len(payload), reason="stream not held")
        return answer(replica.stream, replica.log, want, self._snapshots)

    # How it works: what is said

    def _commit(
        self,
        *,
        facts: FactsStep | None = None,
        submaps: Mapping[str, VectorMap] | None = None,
        even_if_nothing: bool = False,
    ) -> bool:
        life = self.own.life
        said = self.author.commit(facts=facts, submaps=submaps, even_if_nothing=even_if_nothing)
        if said is None:
            return False
        record, step = said
        if self.own.life != life:
            self._outputs.append(LifeChanged(self.own.life))
        self._put("delta", record)
        self._said_bytes = len(record)
        self._outputs.extend(changed_events(step))
        if step.before.facts != step.after.facts:
            self._settle(self.robot)  # it may have ended former lives, by whatever call
        return True

    def _say(self, kind: str, payload: bytes) -> None:
        """Publish something that is said again to every robot that appears."""
        self._said[kind] = payload
        self._put(kind, payload)

    def _put(self, kind: str, payload: bytes) -> None:
        self.ledger.sent(kind, len(payload))
        self._outputs.append(Put(self.own.life, kind, payload))

    def _after(self, facts: FactsStep, maps: Mapping[str, VectorMap]) -> Stream:
        own = self.own
        return Stream(own.robot, own.life, own.seq, own.facts.after(facts), {**own.submaps, **maps}, own.link)

    def _check_reach(self, facts: FactsStep, maps: Mapping[str, VectorMap], *, submap: str | None = None) -> None:
        check_reach(self.own, self._after(facts, maps), self._merged_streams(), submap=submap)

    def _check_density(self, maps: Mapping[str, VectorMap], submap: str) -> None:
        others = sum(len(m) for name, m in {**self.own.submaps, **maps}.items() if name != submap)
        reason = check_density(
            maps[submap],
            max_edges=self._limits.edges - others,
            max_edges_in_square=self._limits.edges_in_square,
        )
        if reason is not None:
            raise ConfigError(option="map", value=f"submap {submap}", reason=f"{reason}: no peer would take it")

    def _supersede_former(self) -> FactsStep:
        """The step that ends the own former lives that are held, but for those that go on beside this one."""
        former = {
            life: replica.stream.state
            for (robot, life), replica in self.holdings.replicas.items()
            if robot == self.robot and replica.stream.seq > 0 and (robot, life) not in self.neighbours
        }
        return supersede(former)

    # How it works: what is kept

    def _settle(self, robot: str) -> None:
        """Keep of a robot's lives what is to be kept, and name the own ones."""
        self._dropped(self.holdings.settle(robot, lambda life: (robot, life) in self.neighbours, self._coming))
        self._dropped(self.holdings.find_room(self._present))
        if robot == self.robot:
            names = self.holdings.names(lambda life: (robot, life) in self.neighbours)
            if names != self.own.names:
                with contextlib.suppress(ConfigError):  # without room for it they go unnamed, and stay
                    self._commit(facts=name_lives(self.own.facts, names))

    def _present(self, key: Key) -> bool:
        neighbour = self.neighbours.by_key.get(key)
        return neighbour is not None and neighbour.spoke

    def _dropped(self, streams: Iterable[Stream]) -> None:
        for stream in streams:
            self._catchup.stream_gone(stream.key)
            if self._behind(stream.key):
                self._catchup.want(stream.key, 0.0)
            self._outputs.append(gone_event(stream))

    def _merged_streams(self) -> list[Stream]:
        left_out = self.left_out()
        return [s for s in self.holdings.streams() if s.key not in left_out]

    def _tell_left_out(self, before: set[Key]) -> None:
        streams = {s.key: s for s in self.holdings.streams()}
        changed = [streams[key] for key in sorted(before ^ self.left_out()) if key in streams]
        self._outputs.extend(no_edge_changed(stream) for stream in changed)

    # How it works: bounds

    def _check_allowed(self, robot: str, payload: bytes) -> None:
        if not NAME.fullmatch(robot) or (self._allow is not None and robot not in self._allow):
            raise WireError(robot=robot, size_bytes=len(payload), reason="claimed: not allowed")

    def _budget(self, speaker: Key) -> Budget:
        """What a speaker may have decoded; names that nobody knows share one, for there are endlessly many."""
        known = speaker in self.holdings.replicas or self._present(speaker)
        return self._work.of(speaker[0] if known else "")

    def _payer(self, key: Key, payload: bytes) -> Budget:
        """Whose work a record is: its author's only if its link shows that.

        Else whoever speaks as that author could use its budget up, and it would be heard no more.
        """
        replica, head = self.holdings.replicas.get(key), envelope.record_head(payload)
        if replica is not None and head is not None and replica.is_next(*head):
            return self._budget(key)
        return self._work.of("")

    def _check_work(self, speaker: Key, payload: bytes, now_s: float) -> None:
        if self._budget(speaker).left(now_s) <= 0:
            raise WireError(robot=speaker[0], size_bytes=len(payload), reason="claimed: too much work")

    def _count(self, robot: str, kind: str, payload: bytes, work: object) -> None:
        self.ledger.received(robot, kind, len(payload))
        try:
            work()  # type: ignore[operator]
        except WireError as error:
            self.ledger.dropped(robot, kind, len(payload), reason=_short(error))


def _millimetres(option: str, point_xy: tuple[float, float]) -> tuple[int, int]:
    if not all(math.isfinite(v) and abs(v) * 1e3 <= MAX_MM for v in point_xy):
        raise ConfigError(
            option=option, value=point_xy, reason=f"expected finite numbers of at most {MAX_MM // 1000} m"
        )
    return round(point_xy[0] * 1e3), round(point_xy[1] * 1e3)


def _short(error: WireError | ConfigError) -> str:
    """A refusal's reason without its numbers, so that there are few of them to count."""
    return "".join(c for c in error.reason if not c.isdigit())[:40]
