"""The engine: what the link delivers and times go in, things for the link to do and events come out.

No I/O, no thread, no clock, no randomness. An author numbers its revisions, and a record leads from one to the next.
Who finds a gap, hears a heartbeat that is ahead, or meets a peer for the first time, asks: the author, or any peer that
mirrors it. Nothing that comes from the network raises; what is refused is counted by the name that it claims, kind and
reason.

    record  ->  next one of a life?  ->  applied, told to the user
                not yet              ->  ask the author, or who holds more   ->  records, or a snapshot
    heartbeat or list says that somebody holds more, or something else       ->  ask

Here is what is heard. ``voice`` says, ``asking`` asks, ``answers`` answers, ``guard`` refuses.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from fleetmap.accounting import Ledger
from fleetmap.codecs import envelope
from fleetmap.codecs.facts import (
    FactsStep,
    addresses_of,
    forget,
    name_lives,
    set_addresses,
    set_anchor,
    set_level,
    set_start,
    set_start_sigma,
    supersede,
)
from fleetmap.codecs.facts.sigma import USUAL as USUAL_SIGMA
from fleetmap.codecs.messages import (
    MAX_EPSILON_CELLS,
    MAX_LIFE,
    MAX_MM,
    PROFILES,
    Heartbeat,
    Living,
    Range,
    Ranges,
    Record,
    Relay,
    RevisionList,
    SnapshotChunk,
)
from fleetmap.codecs.names import check_name
from fleetmap.engine.answers import Answers
from fleetmap.engine.asking import Asking
from fleetmap.engine.author import Author
from fleetmap.engine.budget import Budget
from fleetmap.engine.catchup import GRACE_S, About
from fleetmap.engine.chain import Chain
from fleetmap.engine.changes import changed_events, gone_event, no_edge_changed
from fleetmap.engine.components import Components, Remembered
from fleetmap.engine.guard import REFUSED_COUNTS, Guard
from fleetmap.engine.holdings import Holdings
from fleetmap.engine.inputs import Alive, Foreign, Gone, Input, Message, Query, Reply, ReplyEnd, Replying
from fleetmap.engine.neighbours import ALIVE_MASK, Neighbour, Neighbours
from fleetmap.engine.outputs import Answer, Ask, LookAgain, Output, PeersChanged
from fleetmap.engine.quota import Quota
from fleetmap.engine.ranges import place
from fleetmap.engine.reach import check_reach
from fleetmap.engine.relays import FIRST_RETRY_S, Listening, Relaying
from fleetmap.engine.replica import Outcome
from fleetmap.engine.stream import Key, Limits, Step, Stream
from fleetmap.engine.teammates import Teammates
from fleetmap.engine.voice import Voice
from fleetmap.engine.votes import contradictions
from fleetmap.model.density import check_density
from fleetmap.model.errors import ConfigError, WireError, reason_without_numbers
from fleetmap.model.pose import FixedPose, wrap
from fleetmap.model.vectormap import VectorMap

MAX_ADDRESSES = 32
MAX_OTHERS = 64
"""Robots of other versions that are remembered."""
LARGEST_LIVES = 5
"""So many times what one life may hold all lives of a name may hold together: that of four former ones, and of one. A
life that is there goes for none of them: whoever invents others can't crowd out who runs."""


class Engine:
    """One robot's side of the exchange.

    Parameters
    ----------
    robot : own name
    chain : the links of the own life
    level : robots of different levels are never merged
    start : T_fleet_robot, None if unknown
    start_sigma : how exact that is: standard deviations, micrometres and microradians
    heartbeat_s : how often the own revision is announced while nothing changes
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
        start_sigma: tuple[int, int] = USUAL_SIGMA,
        heartbeat_s: float = 10.0,
        quota: Quota | None = None,
        ledger: Ledger | None = None,
        allow: Collection[str] | None = None,
        limits: Limits | None = None,
    ) -> None:
        self.robot = check_name("robot", robot)
        self.ledger = ledger or Ledger()
        self.author = Author(robot, chain)
        self.limits = limits or Limits()
        self.holdings = Holdings(self.author, most_edges_of_a_name=LARGEST_LIVES * self.limits.edges)
        self.neighbours = Neighbours()
        self.teammates = Teammates()
        self._outputs: list[Output] = []
        self._guard = Guard(robot, allow, self.neighbours.present)
        self.listening, self._relaying = Listening(), Relaying(self._outputs)
        self._asking = Asking(self.holdings, self.neighbours, self._alive, self._outputs, self.ledger)
        self._answers = Answers(self.holdings, self.neighbours, self._state, self.ledger)
        self._voice = Voice(self.author, self._outputs, self.ledger, heartbeat_s=heartbeat_s, quota=quota or Quota())
        self.other_versions: dict[str, int] = {}
        """Robots that speak another version of the protocol, 0 where it isn't said."""
        self._refused: ConfigError | None = None
        self._left_out: set[Key] = set()
        self._placed = Remembered()
        self._commit(
            facts={**set_level(level), **set_start(start), **set_start_sigma(*start_sigma)}, even_if_nothing=True
        )

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
        maps = {**self._voice.waiting_maps, submap: vector_map}
        self._check_density(maps, submap)
        facts = {**self._voice.waiting_facts, **set_anchor(submap, anchor or FixedPose())}
        if supersedes:
            facts |= self._supersede_former()
        self._check_reach(facts, maps, submap=submap)
        self._voice.wait(facts, maps)
        if self._voice.may_send(now_s):
            return self.send_waiting(now_s)
        return self._voice.after(facts, maps).digest != self.own.digest

    def send_waiting(self, now_s: float) -> bool:
        """Say what waits for the quota, whether or not it allows it; False if that is nothing."""
        facts, maps = self._voice.take_waiting()
        size_bytes = self._commit(facts=facts, submaps={**self.own.submaps, **maps}) if maps else 0
        if size_bytes:
            self._voice.sent(size_bytes, now_s)
        return size_bytes > 0

    def set_addresses(self, addresses: Sequence[str]) -> bool:
        """Say where this robot listens."""
        return self._commit(facts=set_addresses(addresses)) > 0

    def addresses(self) -> list[str]:
        """Where others have said that they listen, some of them."""
        said = [address for s in self.holdings.streams() if s.key != self.own.key for address in addresses_of(s.facts)]
        return sorted(set(said))[:MAX_ADDRESSES]

    def set_start(self, start: FixedPose | None) -> bool:
        """Say where the own map frame lies in the fleet's.

        Raises
        ------
        ConfigError : the own maps would lie too far from others of the component (``engine.reach``)
        """
        facts = set_start(start)
        self._check_reach({**self._voice.waiting_facts, **facts}, self._voice.waiting_maps)
        return self._commit(facts=facts) > 0

    def say(self, *facts: FactsStep) -> bool:
        """Say facts about frames (``codecs.facts``: alignments, verdicts); False if they are said already.

        Raises
        ------
        ConfigError : there are more than a stream may have
        """
        together: dict[bytes, bytes | None] = {}
        for step in facts:
            together |= step
        return self._commit(facts=together) > 0

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
                raise ConfigError(
                    option="robot",
                    value=robot,
                    reason="no former life of this robot is held; what others hold of one is here after synced()",
                )
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
        """Announce where the robot is, in its map frame, with the next tick; seldom enough for a radio.

        Raises
        ------
        ConfigError : a number is not finite, or too large
        """
        x_mm, y_mm = _millimetres("pose", (x_m, y_m))
        self._voice.move((x_mm, y_mm, round(wrap(yaw_rad) * 1e3)))

    def set_goal(self, goal_xy: tuple[float, float] | None) -> None:
        """Announce where the robot is going, in its map frame; None: nowhere.

        Raises
        ------
        ConfigError : a number is not finite, or too large
        """
        goal_mm = None if goal_xy is None else _millimetres("goal", goal_xy)
        self._voice.head_for(goal_mm)

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
            case Foreign(robot, alive):
                self._note_version(robot, 0 if alive else None)
            case Gone(robot, life):
                self._on_gone((robot, life), now_s)
            case Query("relay", payload, reply):
                self._count("?", "relay?", payload, lambda: self._on_relay(payload, reply, now_s))
            case Query(kind, payload, reply):
                self._outputs.append(Answer(reply, self._answers.answer(kind, payload, now_s)))
            case Reply(ask_id, payload) if ask_id < 0:
                self._count("?", "relayed", payload, lambda: self._on_relayed(ask_id, payload, now_s))
            case Reply(ask_id, payload):
                about = self._asking.catchup.about(ask_id)
                name = about.peer[0] if about else "?"
                self._count(name, "reply", payload, lambda: self._on_reply(ask_id, about, payload, now_s))
            case ReplyEnd(ask_id) if ask_id < 0:
                self._on_relay_end(ask_id, now_s)
            case ReplyEnd(ask_id):
                self._asking.in_vain(self._asking.catchup.ended(ask_id, now_s), now_s)
        self._asking.ask_due(now_s)

    def tick(self, now_s: float) -> None:
        """Send the heartbeat and the questions that are due. Call it some ten times a second."""
        self.holdings.now_s = now_s
        self._voice.beat(self.holdings.held_hash, self._alive, now_s)
        if self._voice.may_send(now_s):
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
        if self._voice.answers_doubt(now_s):
            self._commit(even_if_nothing=True)
        for key in self.listening.silent(now_s):
            self._asking.look_for(key, now_s + FIRST_RETRY_S)
        for ask_id, via, key in self.listening.due(now_s):
            payload = envelope.encode(Relay(*key))
            self.ledger.sent("want", len(payload))
            self._outputs.append(Ask(ask_id, *via, "relay", payload))
        self._asking.ask_due(now_s)

    def take_outputs(self) -> list[Output]:
        """What came out since the last call, in order. To be called after each of the others."""
        outputs = self._outputs.copy()
        self._outputs.clear()
        return outputs

    # What is known

    def ask_lists(self, *, now_s: float) -> None:
        """Ask all that are there what they hold."""
        for key, neighbour in self.neighbours.by_key.items():
            neighbour.listed = False
            self._asking.catchup.want_list(key, now_s)

    def living(self) -> set[str]:
        """Names that are there, or heard by way of others. Any thread may call it."""
        return self.neighbours.robots() | self.listening.robots()

    def is_there(self, key: Key) -> bool:
        """Whether a life's token is there and has ever spoken, or it is heard by way of others. Any thread may ask."""
        way = self.listening.ways.get(key)
        return self.neighbours.present(key) or (way is not None and way.spoke)

    def lacking(self) -> list[str]:
        """What is missing of what living peers hold, or disputed, in words; empty when this robot is in step."""
        disputed = sorted(self.disputed().items())
        return [*self._asking.lacking(), *(f"{text}; forget({robot!r}) leaves it out" for robot, text in disputed)]

    def left_out(self) -> set[Key]:
        """Streams that are kept and not merged."""
        return self.holdings.left_out(self.is_there)

    def merged_streams(self) -> list[Stream]:
        """Streams that are kept and merged, ascending by robot and life."""
        left_out = self.left_out()
        return [s for s in self.holdings.streams() if s.key not in left_out]

    def placed_streams(self) -> list[Stream]:
        """Those and the own one, whoever has it forgotten."""
        own = self.own
        return sorted([own, *(s for s in self.merged_streams() if s.key != own.key)], key=lambda s: s.key)

    def components(self) -> Components:
        """Which of them are connected, and where each lies. Any thread may ask."""
        return self._components_with(self.own)

    def disputed(self) -> dict[str, str]:
        """Robots whose maps the others don't agree about, and who says what; those that are left out don't count.

        Any thread may ask.
        """
        left_out = self.left_out()
        told: dict[str, str] = {}
        otherwise = {key for n in list(self.neighbours.by_key.values()) for key in list(n.rows)}
        for replica in list(self.holdings.replicas.values()):
            stream = replica.stream
            doubtful = replica.forked or replica.outvoted or stream.key in otherwise
            if not doubtful or not replica.kept or stream.seq == 0 or stream.key in left_out:
                continue
            life = f"{stream.robot} life {stream.life:016x} seq {stream.seq}"
            if replica.forked:
                told[stream.robot] = f"{life} is disputed: its author has said two things; its next word decides"
            elif not self.is_there(stream.key):
                claims = self._asking.claims(stream.key)
                if sides := contradictions(claims, stream.revision, self.robot):
                    who = "; ".join(f"{', '.join(names)}: digest {digest:016x}" for digest, names in sides.items())
                    told[stream.robot] = f"{life} is disputed: its author is absent, and {who}"
        return told

    # How it works: what is heard

    def _on_message(self, key: Key, kind: str, payload: bytes, now_s: float) -> None:
        robot, _ = key
        if not self._guard.allows(robot):
            raise WireError(robot=robot, size_bytes=len(payload), reason="claimed: not allowed")
        payer = self._guard.payer_of_record(key, self.holdings.replicas.get(key), payload)
        if kind == "delta":
            self._guard.check(payer, robot, payload, now_s)
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
                self._on_words(key, message, payload, now_s, speaker=key, payer=payer)
            case "digest", Heartbeat():
                if neighbour is not None:
                    self._on_heartbeat(neighbour, message, payload, now_s)
            case _:
                raise WireError(robot=robot, size_bytes=len(payload), reason="wrong key")
        for _ in range(self._relaying.hand_on(key, payload, now_s)):
            self.ledger.sent("relay", len(payload))
        if neighbour is not None:
            neighbour.steady = neighbour.steady or kind == "digest"
            self._spoke(neighbour)

    def _on_reply(self, ask_id: int, about: About | None, payload: bytes, now_s: float) -> None:
        if about is None:
            raise WireError(robot="?", size_bytes=len(payload), reason="late")
        name, catchup = about.peer[0], self._asking.catchup
        neighbour = self.neighbours.by_key.get(about.peer)
        payer = self._guard.payer_of_reply(about.peer, self.holdings.replicas.get(about.peer))
        self._guard.check(payer, name, payload, now_s)
        if about.stream is None:
            payer.spend(len(payload))
        match envelope.decode(payload, robot=name):
            case RevisionList(rows) if about.stream is None and neighbour is not None:
                catchup.helped(ask_id, now_s)
                self._on_ranges(neighbour, [Range(0, MAX_LIFE, rows=rows)], now_s)
            case Ranges(ranges) if about.stream is None and neighbour is not None:
                catchup.helped(ask_id, now_s)
                self._on_ranges(neighbour, ranges, now_s)
            case Heartbeat() as message if about.stream is None and neighbour is not None:
                self._on_heartbeat(neighbour, message, payload, now_s)
                if neighbour.listed:  # else a list follows, or is lost
                    catchup.helped(ask_id, now_s)
            case Living(tokens) if about.stream is None and neighbour is not None:
                self._on_living(neighbour, tokens, now_s)
            case (Record() | SnapshotChunk()) as message if about.stream == self.own.key:
                self._on_own_proof(message)
            case (Record() | SnapshotChunk()) as message if about.stream is not None:
                self._on_words(about.stream, message, payload, now_s, speaker=about.peer, payer=payer)
                catchup.helped(ask_id, now_s)
            case _:
                raise WireError(robot=name, size_bytes=len(payload), reason="not what was asked")
        if neighbour is not None:
            neighbour.steady = True
            self._spoke(neighbour)

    def _on_words(
        self, key: Key, message: Record | SnapshotChunk, raw: bytes, now_s: float, *, speaker: Key, payer: Budget
    ) -> None:
        """A record or a part of a snapshot, by whatever way it came: from its author, or from a mirror."""
        robot, by_author = key[0], speaker == key
        # Kept only once it has said something that holds: who invents streams fills no table.
        replica = self.holdings.to_change(key)
        try:
            if isinstance(message, Record):
                outcome = replica.offer(message, raw, self.limits, by_author=by_author)
            else:
                believed = self._asking.believed(replica)
                outcome = replica.offer_chunk(message, self.limits, speaker=speaker, instead=believed)
        except WireError as error:
            if not error.reason.startswith("claimed"):
                # Decoded, and in vain: the author's words don't fit what is held, or a mirror lies.
                payer.spend(REFUSED_COUNTS * len(raw))
                if by_author:
                    self._asking.announced(key, message.seq, now_s)
            raise
        if key not in self.holdings.replicas and (replica.stream.seq > 0 or not isinstance(message, Record)):
            self.holdings.hold(replica)
            self._dropped(self.holdings.find_room(self.is_there, newcomer=key))
        for step in replica.take_steps():
            self._moved(step)
        match outcome:
            case Outcome.APPLIED:
                way = self.listening.ways.get(key)
                if not by_author and (way is None or way.via != speaker):
                    self._voice.stir()  # by a mirror: others may lack it, too
                if not self._asking.behind(key):
                    self._asking.catchup.settled(key)
            case Outcome.EARLY:
                if isinstance(message, Record) and by_author:
                    self._asking.announced(key, message.seq, now_s + GRACE_S)
                if lost := self.holdings.bound_waiting():
                    self.ledger.dropped(robot, "early", lost, reason="no room")
            case Outcome.FORKED:
                raise WireError(robot=robot, size_bytes=len(raw), reason="claimed: other bytes under the same seq")
            case Outcome.DUPLICATE:
                raise WireError(robot=robot, size_bytes=len(raw), reason="duplicate")

    def _on_heartbeat(self, neighbour: Neighbour, message: Heartbeat, payload: bytes, now_s: float) -> None:
        neighbour.said = payload
        self.teammates.hear(neighbour.key, message, now_s)
        self._asking.heartbeat(neighbour, message, now_s)

    def _on_ranges(self, neighbour: Neighbour, ranges: Sequence[Range], now_s: float) -> None:
        """What a neighbour holds, as far as it was asked."""
        allowed = []
        for of in ranges:
            rows = None if of.rows is None else tuple(row for row in of.rows if self._guard.allows(row[0]))
            allowed.append(Range(of.first, of.last, of.held, rows))
            for robot, revision in rows or ():
                own = self.own.revision
                if (robot, revision.life, revision.seq) == (self.robot, own.life, own.seq) and revision != own:
                    self._voice.doubted = True
        self._asking.listed(neighbour, allowed, now_s)

    def _on_own_word(self, message: object, payload: bytes) -> None:
        """Somebody speaks in this life's name: a stranger, or a copy of this process' memory or disk."""
        if isinstance(message, Record):
            self._on_own_proof(message)
        raise WireError(robot=self.robot, size_bytes=len(payload), reason="claimed: the own life")

    def _on_own_proof(self, message: Record | SnapshotChunk) -> None:
        """If the link is right, this life has come to that seq, and goes on behind what this process hasn't said."""
        chain, own = self.author.chain, self.own.revision
        proven = own.seq <= message.seq <= chain.revisions and message.link == chain.link(message.seq)
        if proven and (message.seq > own.seq or message.check != own.check):
            self.author.skip_to(message.seq)
            self._voice.doubted = True
        if not self._asking.behind(self.own.key):
            self._asking.catchup.settled(self.own.key)

    def _moved(self, step: Step) -> None:
        """A replica has taken a step."""
        robot = step.after.robot
        self.holdings.moved(step.after.key)
        # A step with facts may leave other streams out, or bring them back.
        facts_changed = step.before.facts != step.after.facts
        self._outputs.extend(changed_events(step))
        self._settle(robot)
        if facts_changed:
            if step.after.forgets.get(self.own.key) == self.own.state:
                self._voice.doubted = True  # whoever lives is in the map
            if step.after.robot == self.robot and step.after.supersedes.get(self.own.life) == self.own.state:
                self._voice.doubted = True

    # How it works: who is there

    def _on_alive(self, key: Key, now_s: float) -> None:
        if key == self.own.key:
            return
        if not self._guard.allows(key[0]):
            self.ledger.dropped(key[0], "alive", 0, reason="claimed: not allowed")
            return
        there, silent = self.neighbours.add(key)
        if silent is not None:
            self._left(silent)
        if not there:
            self.ledger.dropped(key[0], "alive", 0, reason="too_many_peers")
            return
        self._asking.appeared(key, now_s)
        self._settle(key[0])

    def _on_gone(self, key: Key, now_s: float) -> None:
        """Its map stays, and it is absent."""
        neighbour = self.neighbours.remove(key)
        if neighbour is None:
            return
        self._left(neighbour)
        if neighbour.spoke:
            # Perhaps only the link to it is gone.
            self._asking.look_for(key, now_s)
        if self.neighbours.refused:
            self.neighbours.refused = False
            self._outputs.append(LookAgain())

    def _left(self, neighbour: Neighbour) -> None:
        robot, _ = neighbour.key
        self._asking.catchup.peer_gone(neighbour.key)
        self._relaying.gone(neighbour.key)
        for key in self.listening.lost(neighbour.key):
            self._unheard(key)
        if neighbour.spoke and robot not in self.living():
            self.teammates.gone(robot)
            self._outputs.append(PeersChanged(robot, False))
        self._settle(robot)

    def _spoke(self, neighbour: Neighbour) -> None:
        neighbour.unanswered = 0
        self.other_versions.pop(neighbour.key[0], None)
        if not neighbour.spoke:
            robot = neighbour.key[0]
            new = robot not in self.neighbours.robots()
            neighbour.spoke = True
            self.listening.linked(neighbour.key)
            if new:
                self._outputs.append(PeersChanged(robot, True))

    def _alive(self) -> int:
        """One hash over who is there, and who is heard by way of others."""
        heard = sum(place(key) for key, way in self.listening.ways.items() if way.spoke)
        return (self.neighbours.alive(self.own.key) + heard) & ALIVE_MASK

    def _state(self) -> Heartbeat:
        return self._voice.state(self.holdings.held_hash(), self._alive())

    # How it works: who is heard by way of others

    def _on_living(self, neighbour: Neighbour, tokens: Iterable[Key], now_s: float) -> None:
        """A neighbour says whom it sees."""
        # Not who has the own name: its neighbour may not have noticed yet that the process before this one ended.
        others = {key for key in tokens if key[0] != self.robot and self._guard.allows(key[0])}
        self.listening.told(neighbour.key, {key for key in others if not self.neighbours.present(key)}, now_s)

    def _on_relay(self, payload: bytes, reply: Replying, now_s: float) -> None:
        """Somebody has no link to one that is there."""
        asked, neighbour = None, None
        try:
            asked = envelope.decode(payload, robot="?")
            if not isinstance(asked, Relay):
                raise WireError(robot="?", size_bytes=len(payload), reason="not a question")
            neighbour = self.neighbours.by_key.get((asked.robot, asked.life))
        finally:
            if neighbour is None or not neighbour.spoke or not self._relaying.begin(neighbour.key, reply, now_s):
                self._outputs.append(Answer(reply, ()))
            elif neighbour.said:
                self._outputs.append(Answer(reply, (neighbour.said,), last=False))

    def _on_relayed(self, ask_id: int, payload: bytes, now_s: float) -> None:
        """What a neighbour hands on."""
        found = self.listening.way_of(ask_id)
        if found is None:
            return  # it is seen itself by now
        key, way = found
        payer = self._guard.payer_of_reply(way.via, self.holdings.replicas.get(way.via))
        self._guard.check(payer, way.via[0], payload, now_s)
        message, via = envelope.decode(payload, robot=way.via[0]), self.neighbours.by_key.get(way.via)
        match message:
            case Heartbeat():
                self.teammates.hear(key, message, now_s)
            case Record():
                self._on_words(key, message, payload, now_s, speaker=way.via, payer=payer)
            case _:
                raise WireError(robot=way.via[0], size_bytes=len(payload), reason="not what was asked")
        if via is not None:
            self._asking.claim(via, key, message.seq, now_s + GRACE_S)
        if not way.spoke:
            new = key[0] not in self.living()
            way.spoke = True
            if new:
                self._outputs.append(PeersChanged(key[0], True, way.via[0]))

    def _on_relay_end(self, ask_id: int, now_s: float) -> None:
        key = self.listening.ended(ask_id, now_s)
        if key is not None:
            self._unheard(key)
            self._asking.look_for(key, now_s)

    def _unheard(self, key: Key) -> None:
        if key[0] not in self.living():
            self.teammates.gone(key[0])
            self._outputs.append(PeersChanged(key[0], False))

    # How it works: what is said

    def _commit(
        self,
        *,
        facts: FactsStep | None = None,
        submaps: Mapping[str, VectorMap] | None = None,
        even_if_nothing: bool = False,
    ) -> int:
        """Say the next revision; the bytes of its record, 0 if it would change nothing and is not said."""
        said = self.author.commit(facts=facts, submaps=submaps, even_if_nothing=even_if_nothing)
        if said is None:
            return 0
        record, step = said
        self._voice.say(record)
        self._outputs.extend(changed_events(step))
        if step.before.facts != step.after.facts:
            self._settle(self.robot)  # it may have ended former lives, by whatever call
        return len(record)

    def _check_reach(self, facts: FactsStep, maps: Mapping[str, VectorMap], *, submap: str | None = None) -> None:
        after = self._voice.after(facts, maps)
        check_reach(self.own, after, self.merged_streams(), self._components_with, submap=submap)

    def _components_with(self, own: Stream) -> Components:
        """Where all streams lie, if the own one were that one."""
        return self._placed.of(own if stream.key == own.key else stream for stream in self.placed_streams())

    def _check_density(self, maps: Mapping[str, VectorMap], submap: str) -> None:
        others = sum(len(m) for name, m in {**self.own.submaps, **maps}.items() if name != submap)
        reason = check_density(
            maps[submap],
            max_edges=self.limits.edges - others,
            max_edges_in_square=self.limits.edges_in_square,
        )
        if reason is not None:
            raise ConfigError(option="map", value=f"submap {submap}", reason=f"{reason}: no peer would take it")

    def _supersede_former(self) -> FactsStep:
        """The step that ends the own former lives that are held, but for those that go on beside this one."""
        former = {
            life: replica.stream.state
            for (robot, life), replica in self.holdings.replicas.items()
            if robot == self.robot and replica.stream.seq > 0 and not self.is_there((robot, life))
        }
        return supersede(former)

    # How it works: what is kept

    def _settle(self, robot: str) -> None:
        """Keep of a robot's lives what is to be kept, and name the own ones."""

        def there(life: int) -> bool:
            return self.is_there((robot, life))

        def coming(key: Key) -> bool:
            return self._asking.behind(key, waiting=True)

        self._dropped(self.holdings.settle(robot, there, coming))
        self._dropped(self.holdings.find_room(self.is_there))
        if robot == self.robot:
            names = self.holdings.names(there)
            if names != self.own.names:
                with contextlib.suppress(ConfigError):  # without room for it they go unnamed, and stay
                    self._commit(facts=name_lives(self.own.facts, names))

    def _dropped(self, streams: Iterable[Stream]) -> None:
        for stream in streams:
            self._voice.stir()
            self._asking.dropped(stream)
            self._outputs.append(gone_event(stream))

    def _tell_left_out(self, before: set[Key]) -> None:
        streams = {s.key: s for s in self.holdings.streams()}
        changed = [streams[key] for key in sorted(before ^ self.left_out()) if key in streams]
        self._outputs.extend(no_edge_changed(stream) for stream in changed)

    def _count(self, robot: str, kind: str, payload: bytes, work: Callable[[], None]) -> None:
        self.ledger.received(robot, kind, len(payload))
        try:
            work()
        except WireError as error:
            if error.version is not None:
                self._note_version(robot, error.version)
            self.ledger.dropped(robot, kind, len(payload), reason=reason_without_numbers(error))

    def _note_version(self, robot: str, version: int | None) -> None:
        if version is None:
            self.other_versions.pop(robot, None)
        elif len(self.other_versions) < MAX_OTHERS and self._guard.allows(robot):
            self.other_versions[robot] = version


def _millimetres(option: str, point_xy: tuple[float, float]) -> tuple[int, int]:
    if not all(math.isfinite(v) and abs(v) * 1e3 <= MAX_MM for v in point_xy):
        raise ConfigError(
            option=option, value=point_xy, reason=f"expected finite numbers of at most {MAX_MM // 1000} m"
        )
    return round(point_xy[0] * 1e3), round(point_xy[1] * 1e3)
