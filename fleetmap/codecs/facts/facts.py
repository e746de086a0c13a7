"""What an author says beside edges: a map of facts, each a key and a few bytes.

The first byte of a key is its kind, the rest is what the fact is about. A kind is a file of this folder. One that this
version doesn't know is kept, digested and passed on like the others, so that versions can live side by side.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

MAX_FACTS = 2048
MAX_KEY_BYTES = 96
MAX_VALUE_BYTES = 1024
MAX_FACTS_BYTES = 256 << 10
"""Bounds of one stream: of keys and values together, and of each."""

FactsStep = Mapping[bytes, bytes | None]
"""What changes: key -> its new value, None where the fact is taken back."""


class Facts(Mapping[bytes, bytes]):
    """The facts of one revision; never changes.

    Parameters
    ----------
    items : key -> value; ``check_facts`` says whether they are in their bounds
    """

    __slots__ = ("_by_kind", "_items")

    def __init__(self, items: Mapping[bytes, bytes] | None = None) -> None:
        self._items = dict(sorted((items or {}).items()))
        self._by_kind: dict[int, dict[bytes, bytes]] = {}
        for key, value in self._items.items():
            self._by_kind.setdefault(key[0], {})[key[1:]] = value

    def __getitem__(self, key: bytes) -> bytes:
        return self._items[key]

    def __iter__(self) -> Iterator[bytes]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def of(self, kind: int) -> Mapping[bytes, bytes]:
        """The facts of one kind: what each is about -> its value."""
        return self._by_kind.get(kind, {})

    def after(self, step: FactsStep) -> Facts:
        """The facts after a step; the same object if it changes nothing."""
        if all(self.get(key) == value for key, value in step.items()):
            return self
        items = {**self._items, **{key: value for key, value in step.items() if value is not None}}
        return Facts({key: value for key, value in items.items() if step.get(key, b"") is not None})

    def step_to(self, after: Facts) -> dict[bytes, bytes | None]:
        """What changes from these facts to those."""
        if after is self:
            return {}
        gone: dict[bytes, bytes | None] = {key: None for key in self if key not in after}
        return gone | {key: value for key, value in after.items() if self.get(key) != value}


def check_bounds(facts: Mapping[bytes, bytes]) -> None:
    """``ValueError`` if there are too many facts, or one is too large."""
    if len(facts) > MAX_FACTS:
        raise ValueError(f"expected at most {MAX_FACTS} facts")
    for key, value in facts.items():
        if not 1 <= len(key) <= MAX_KEY_BYTES or len(value) > MAX_VALUE_BYTES:
            raise ValueError(f"expected keys of 1 to {MAX_KEY_BYTES} B and values of at most {MAX_VALUE_BYTES} B")
    if sum(len(key) + len(value) for key, value in facts.items()) > MAX_FACTS_BYTES:
        raise ValueError(f"expected facts of at most {MAX_FACTS_BYTES} B in all")
