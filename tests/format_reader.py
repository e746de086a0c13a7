"""A reader in plain Python, written from docs/format.md and docs/protocol.md alone, with the names of these pages.

It takes well-formed bytes: of what a reader refuses there is nothing here.
"""

import zlib
from bisect import bisect_left
from collections import Counter, defaultdict
from hashlib import sha256
from itertools import accumulate, chain, count, repeat

import msgpack

LABELS = (1, 2, 5, None)  # of edges of class 0, 1, 2 as they are walked; of no edge
WINDOWS, FIRST_BAND, BANDS, FIRST_COLUMN, COLUMNS, REMOVED, WALKS = range(0, 79, 13)
ROOTS, LEAST, WIDTH, ROW, TARGET, RETHICKENED, FIRST_GAP, GAP, VALUE, LOWER = range(117, 235, 13)
GOES, TRIANGLE, CLASS, HITS, ENDS, STEP, SAME, THICKNESS = 780, 876, 878, 1256, 2156, 2160, 13378, 13384
THICKNESS_TO = 13704
P = [0, 1, 1, 2, 3, 5, 8, 13, 22, 36, 60, 98, 162, 267, 439, 720, 1179, 1921, 3108, 4971, 7812, 11955, 17625, 24743]
P += [32768] + [65536 - p for p in reversed(P)]
S = [min(max(P[x >> 7] * (128 - x % 128) + P[(x >> 7) + 1] * (x % 128) >> 7, 1), 65535) for x in range(1, 6144)]
# The cells W, NW, N, NE, WW, NN, WWW, NWW, NEE, NNW, NNE, NNN as (dy, dx)
NEAR = ((0, -1), (-1, -1), (-1, 0), (-1, 1), (0, -2), (-2, 0), (0, -3), (-1, -2), (-1, 2), (-2, -1), (-2, 1), (-3, 0))


def turned(edge):
    """An edge as it is walked, if it is given as in a map; as in a map, if it is given as it is walked."""
    y0, x0, y1, x1, label = edge
    return edge if (y0, x0) < (y1, x1) and label in LABELS else (y1, x1, y0, x0, 3 * (label % 3) + label // 3)


def polar(dy, dx):
    """Quadrant, length and offset of a step."""
    views = ((dx, dy), (dy, -dx), (-dx, -dy), (-dy, dx))
    return next(((Q, a, o) for Q, (a, o) in enumerate(views) if -a < o <= a), (0, 0, 0))


def read_payload(payload, base, tables):
    """The map (edge: thickness) that a payload makes of its base."""
    data, order, frontiers = payload[1:], sorted(base), bool(payload[0] & 0x20)
    if payload[0] & 15:
        coder = Coder(data, tables.DELTA if base else tables.SNAPSHOT)
        removed, added, changed = read_mode_1(coder, base, order, frontiers)
    else:
        data = zlib.decompress(data, -15) if payload[0] & 0x10 else data
        removed, added, changed = read_mode_0(iter(data), order, frontiers)
    return {edge: base[edge] for edge in order if edge not in removed} | changed | added


def leb128(data):
    """The next number of an iterator over bytes."""
    byte = next(data)
    return byte if byte < 128 else byte - 128 + 128 * leb128(data)


def read_mode_0(data, order, frontiers):
    """Removed, added and rethickened edges; order is the base in canonical order."""
    counts, zigzag = [leb128(data) for _ in range(6)], lambda n: n >> 1 ^ -(n & 1)
    removed = [order[place - 1] for place in accumulate(leb128(data) + 1 for _ in range(counts[0]))]
    ends = sorted({end for edge in removed for end in (edge[:2], edge[2:4])})
    roots = [ends[rank] for rank in accumulate(leb128(data) for _ in range(counts[1]))]
    y, x = removed[0][:2] if removed else (0, 0)
    for _ in range(counts[2]):
        y, x = y + zigzag(leb128(data)), x + zigzag(leb128(data))
        roots.append((y, x))
    walked = []  # the added edges, as they are walked
    for number in [leb128(data) for _ in range(counts[3])]:
        y, x = (y, x) if number & 1 else roots.pop(0)
        for _ in range(number // 6 + 1):
            walked.append((y, x, y + zigzag(leb128(data)), x + zigzag(leb128(data)), LABELS[number // 2 % 3]))
            y, x = walked[-1][2:4]
    thickness = chain.from_iterable([repeat(leb128(data), leb128(data)) for _ in range(counts[4])])
    added = {turned(edge): next(thickness) if edge[4] != 2 or frontiers else 0 for edge in walked}
    changed = {order[place - 1]: leb128(data) for place in accumulate(leb128(data) + 1 for _ in range(counts[5]))}
    return removed, added, changed


class Coder:
    """Decisions (of the exact layer, too), contexts and numbers of mode 1."""

    def __init__(self, data, table=((), ())):
        self.data, self.range = chain(data, repeat(0)), 2**32 - 1
        self.code = int.from_bytes([next(self.data) for _ in range(4)], "big")
        self.contexts = [(256 * b + 128, 256 * b + 128, m) for b, m in zip(*table, strict=True)]

    def decide(self, chance=2**15):
        """A decision that has this chance of 2^16; an even one without."""
        bound = (self.range >> 16) * chance
        decision = self.code < bound
        self.code, self.range = (self.code, bound) if decision else (self.code - bound, self.range - bound)
        while self.range < 2**24:
            self.code, self.range = (self.code << 8) + next(self.data), self.range << 8
        return decision

    def bit(self, context):
        """A decision in a context."""
        p, q, n = self.contexts[context]
        v = self.decide(min(max(p + q >> 1, 32), 65504))
        a, d = 65535 * v, 327680 // (5 * n + 8)
        p, q = p + ((a - p) * max(d, 4096) >> 16), q + ((a - q) * max(d, 512) >> 16)
        self.contexts[context] = p, q, min(n + 1, 127)
        return v

    def number(self, context, lower=LOWER, e=-1):
        """N of the page."""
        value, L = 1, next(i for i in count() if not self.bit(context + min(i, 12)))
        for k in range(L):
            j, expected = value - 1 if k < 3 else min(4 + k, 12), e + 1 >> L - k - 1
            t = 1 + expected % 2 if expected // 2 == value else 0
            value = 2 * value + (self.bit(lower + 39 * L + 3 * j + t) if L <= 13 else self.decide())
        return value - 1

    def signed(self, context):
        """S of the page."""
        value = self.number(context)
        return -value if value and self.decide() else value

    def depth(self, context):
        """T of the page, a thickness."""
        k = 1
        for _ in range(5):
            k = 2 * k + self.bit(context + k)
        return k - 32 if k < 63 else 31 + self.number(VALUE)


def read_removed(coder, order):
    """The removed edges in canonical order: steps 1 and 2 of mode 1."""
    bands, windows, band, column = sorted({edge[0] // 64 for edge in order}), [], 0, 0
    for _ in range(coder.number(WINDOWS)):
        band += coder.number(FIRST_BAND)
        rows = range(bands[band], bands[band + coder.number(BANDS)] + 1)
        column += coder.signed(FIRST_COLUMN)
        windows.append((rows, range(column, column + coder.number(COLUMNS) + 1), coder.number(REMOVED) + 1))
    removed, touched = [], Counter()
    for rows, columns, left in windows:
        last = 0
        for edge in order:
            if left and edge[0] // 64 in rows and edge[1] // 64 in columns:
                a, b, kind = touched[edge[:2]], touched[edge[2:4]], LABELS.index(turned(edge)[4])
                last = coder.bit(GOES + 2 * (16 * kind + 4 * a + b) + last)
                touched[edge[:2]], touched[edge[2:4]] = a | 1 + last, b | 1 + last
                removed += [edge] * last
                left -= last
    return sorted(removed)


def read_mode_1(coder, base, order, frontiers):
    """Removed, added and rethickened edges; order is the base in canonical order."""
    removed = read_removed(coder, order)
    leaving = {edge[:2]: edge for edge in map(turned, reversed(removed))}
    surplus = Counter(turned(edge)[:2] for edge in removed)
    surplus.subtract(turned(edge)[2:4] for edge in removed)
    roots = [
        p for p in sorted(surplus) for _ in range(coder.number(WALKS + 13 * ((surplus[p] > 0) + (surplus[p] >= 0))))
    ]
    known, absolute, (y, x) = len(roots), coder.number(ROOTS), removed[0][:2] if removed else (0, 0)
    if absolute:
        y, x, w = y + coder.signed(LEAST), x + coder.signed(LEAST), coder.number(WIDTH).bit_length()
        for _ in range(absolute):
            y += coder.number(ROW)
            roots.append((y, x + sum(coder.decide() << k for k in reversed(range(w)))))
    targets = [point for point in sorted(surplus) for _ in range(-surplus[point])][:32]
    added, triangle = {}, 0
    for n, root in enumerate(roots):
        closes = n >= known or surplus[root] <= 0
        triangle = coder.bit(TRIANGLE + triangle) if closes else triangle
        back = leaving.get(root) if n < known else None
        walk = read_walk(coder, root, targets, closes, closes and triangle, back or (0, 0, 0, 0, None))
        added |= read_thickness(coder, walk, base[turned(back)] if back and back[4] != 2 else None, frontiers)
    place, changed = order.index(removed[0]) if removed else 0, {}
    for n in range(coder.number(RETHICKENED)):
        place += coder.number(GAP) + 1 if n else coder.signed(FIRST_GAP)
        changed[order[place]] = coder.depth(THICKNESS_TO)
    return removed, added, changed


def read_walk(coder, root, targets, closes, triangle, back):
    """The edges of a walk, as they are walked; takes the target that it reaches from the list."""
    (y, x), goals, walk = root, targets + [root] * closes, []
    Q, a1, o1 = polar(back[2] - back[0], back[3] - back[1])
    q, u, a2, r1 = 3 + LABELS.index(back[4]), 0, 0, 0
    for i in count():
        b1 = min(a1.bit_length(), 5)
        c = CLASS + (336 + 2 * (7 * i + q) if triangle else 2 * (6 * (4 * q + min(u, 3)) + b1))
        kind = coder.bit(c) and 1 + coder.bit(c + 1)
        ways = sorted((abs(Y - y) + abs(X - x), place, Y - y, X - x) for place, (Y, X) in enumerate(goals))
        hit = triangle and i == 2
        if not triangle and ways and ways[-1][0]:
            _, place, Y, X = next(way for way in ways if way[0])
            f, far = sorted((abs(Y), abs(X)))
            k = 0 if f == 0 else 4 if f > 2 else (2, 1, 3, 1)[(polar(Y, X)[0] - Q) % 4]
            own = min(i, 4) if place == len(targets) else 0
            hit = coder.bit(HITS + kind + 3 * (5 * (5 * min(far.bit_length(), 11) + k) + own))
        if hit:
            place = len(targets) if triangle else ways[coder.number(TARGET) if len(ways) > 1 else 0][1]
            del targets[place : place + 1]
            return [*walk, (y, x, *goals[place], LABELS[kind])]
        g = 3 + i if triangle else 5 + kind if q == 3 + kind else kind
        G, v = STEP + 754 + 1308 * g, min(r1, 2) if i else 3
        c = G + 3 * (4 * (5 * b1 + min(a2.bit_length(), 4)) + v)
        r = coder.bit(c)
        r += 2 * coder.bit(c + 1 + r)
        e = a2 - 1 if a2 > 0 and (r + r1) % 2 == 0 else a1 - 1 if g > 4 else -1
        a = 1 + coder.number(G + 360 + 13 * (6 * min(r, 2) + b1), G + 594, e)
        c = G + 1140 + 2 * (3 * (4 * min(a.bit_length(), 6) + r) + (o1 > 0) + (o1 >= 0))
        o = coder.bit(c) and (-1 if a > 1 and coder.bit(c + 1) else 1)
        o = o and o * (1 + coder.number(STEP + 13 * min(a, 15), STEP + 208))
        Q, a1, a2, o1, r1, u, q = (Q + r) % 4, a, a1, o, r, u + 1 if kind == q else 0, kind
        dy, dx = ((o, a), (a, -o), (-o, -a), (-a, o))[Q]
        walk.append((y, x, y + dy, x + dx, LABELS[kind]))
        y, x = y + dy, x + dx
        if not triangle and coder.bit(ENDS + 2 * closes + (len(targets) > 0)):
            return walk


def read_thickness(coder, walk, h, frontiers):
    """The edges of a walk with their thickness; h is that of the edge it looks back to, or None."""
    island = walk[-1][2:4] == walk[0][:2] and sum(x0 * y1 - y0 * x1 for y0, x0, y1, x1, _ in walk) <= 0
    side = min(max(along) - min(along) for along in list(zip(*walk, strict=True))[:2])
    added, thick = dict.fromkeys(map(turned, walk), 0), [i for i, edge in enumerate(walk) if edge[4] != 2 or frontiers]
    for i in thick:
        s = 2 if i == thick[0] else int(i - 1 in thick)
        if h is None or not coder.bit(SAME + 2 * s + island):
            h = coder.depth(THICKNESS + 32 * (2 + min(side, 7) if island else min(LABELS.index(walk[i][4]), 1)))
        added[turned(walk[i])] = h
    return added


def read_exact(data, base):
    """The states of an exact layer, row by row; base: those of its base, or None."""
    data = iter(data)
    rows, columns, coder = range(leb128(data)), range(leb128(data)), Coder(data)
    cells, counters, weights = defaultdict(lambda: 2), defaultdict(lambda: (2**21, 0)), defaultdict(lambda: [22938] * 6)
    shared = defaultdict(lambda: 2, {(y, x): base[y][x] for y in rows for x in columns} if base else {})
    down = Counter()
    for y in rows:
        across = 0
        for x in columns:
            near = [cells[y + dy, x + dx] for dy, dx in NEAR]
            nine = [shared[y + dy, x + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)] if base else []
            W, NW, N, NE, WW, _, _, NWW, NEE, *_ = near
            a, d = min(across.bit_length(), 12), min(down[x].bit_length(), 12)
            wide = (N, NE, NEE, cells[y - 1, x + 3], W, NW, NWW, cells[y - 1, x - 3], WW)
            chosen = [near[:6], near, (a, d, W, N, NE), wide]
            chosen += [(*nine, W, N), (nine[4], nine[5], nine[7], *near[:6])] if base else []
            alike = len({*near, *nine[4:]}) == 1
            turn, v = 0, True
            while v and turn < 2:
                keys = [(turn, i, *states) for i, states in enumerate([(W, a, d)] if alike else chosen)]
                old, chances = weights[turn, W, N, NE], [counters[key][0] for key in keys]
                odds = [min(bisect_left(S, 16 * (C >> 10) + 8) - 3071, 3071) for C in chances]
                c = S[min(max(sum(w * t for w, t in zip(old, odds, strict=False)) >> 16, -3071), 3071) + 3071]
                v = coder.decide(min(max(chances[0] >> 6, 2), 65534) if alike else min(max(c, 32), 65504))
                if not alike:
                    new = [w + (14 * t * (65535 * v - c) + 2**17 >> 18) for w, t in zip(old, odds, strict=False)]
                    weights[turn, W, N, NE] = new
                for key in keys:
                    C, n = counters[key]
                    counters[key] = C + (((2**22 - 1) * v - C) * (131072 // (2 * n + 3)) >> 16), min(n + 1, 1000)
                turn += v
            cells[y, x] = (W + turn) % 3
            across, down[x] = 0 if turn else across + 1, down[x] + 1 if cells[y, x] == N else 0
    return [[cells[y, x] for x in columns] for y in rows]


def hash_of(salt, *values):
    """The hash of the page."""
    h = salt % 2**64
    for v in values:
        h = ((h ^ v % 2**64) + 0x9E3779B97F4A7C15) % 2**64
        h = (h ^ h >> 30) * 0xBF58476D1CE4E5B9 % 2**64
        h = (h ^ h >> 27) * 0x94D049BB133111EB % 2**64
        h ^= h >> 31
    return h


def digest(edges, resolution_um, x, y, cos, sin):
    """The digest of a vector map."""
    lattice, thick = hash_of(1, resolution_um, x, y, cos, sin), [(*e, t) for e, t in edges.items() if t]
    return (lattice + sum(hash_of(2, *edge) for edge in edges) + sum(hash_of(3, *row) for row in thick)) % 2**64


# What follows is docs/protocol.md.


def read_message(data):
    """Kind and fields of a message."""
    first, *fields = msgpack.unpackb(data)
    return first % 16, fields


def read_change(change, facts, submaps, tables):
    """Facts, and submaps (name: (map header, edges)), after a change."""
    changed, new_facts = change[0], change[1] if len(change) > 1 else {}
    submaps = dict(submaps)
    for name, what in (changed if isinstance(changed, dict) else {"0": changed}).items():
        payload, header = what if isinstance(what, list) else (what, None)
        header, base = (header, {}) if header else submaps[name]
        submaps[name] = header, read_payload(payload, base, tables)
    return {key: value for key, value in (facts | new_facts).items() if value is not None}, submaps


def stream_digest(robot, life, facts, submaps):
    """The digest of a stream."""
    author = hash_of(raw(16, robot.encode()), life)
    total = sum(raw(raw(author, key), value) for key, value in facts.items())
    for name, ((resolution_um, pose, epsilon, profile), edges) in submaps.items():
        vector_map = digest(edges, resolution_um, *(pose or (0, 0, 2**30, 0)))
        total += hash_of(raw(author ^ 17, name.encode()), vector_map, round(epsilon * 10**9), profile)
    return total % 2**64


def held_hash(revisions):
    """The hash over all that a peer holds: (robot, life, seq, digest)."""
    return sum(hash_of(raw(18, robot.encode()), *revision) for robot, *revision in revisions) % 2**64


def raw(salt, data):
    """The hash of bytes, with their count."""
    return hash_of(salt, *data, len(data))


def link_before(link, seq):
    """The link of the seq before."""
    return int.from_bytes(sha256(link.to_bytes(8, "big") + seq.to_bytes(4, "big")).digest()[:8], "big")
