"""From a grid to a published submap: one sticky vectorizer a submap, and the baselines beside it."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from fleetmap.accounting import Ledger
from fleetmap.model.errors import ConfigError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.lattice import FREE
from fleetmap.model.threads import in_thread, may_be_dropped
from fleetmap.model.vectormap import VectorMap

if TYPE_CHECKING:
    from fleetmap.vectorize import Vectorizer

logger = logging.getLogger(__name__)


class GridPublisher:
    """Vectorizes grids in a thread, one at a time, and counts what they would have cost as grids.

    Parameters
    ----------
    ledger : where the baselines are counted
    baselines : count them at all; they cost a gzip of the whole grid at each publish
    robot : the own name, for the log
    """

    def __init__(self, ledger: Ledger, *, baselines: bool, robot: str = "") -> None:
        self._ledger, self._baselines, self._robot = ledger, baselines, robot
        self._told: set[str] = set()
        self._vectorizers: dict[str, Vectorizer] = {}
        self._last: dict[str, OccupancyGrid] = {}
        self._turn = asyncio.Lock()

    async def publish(
        self,
        submap: str,
        source: OccupancyGrid | VectorMap,
        send: Callable[[str, VectorMap], Awaitable[bool]],
        *,
        clock: Callable[[], float],
    ) -> bool:
        """Vectorize, ``send``, then count the baselines: the fleet doesn't wait for them."""
        # Shielded: a thread can't be cancelled, and the next turn must not begin beside it.
        task = asyncio.create_task(self._take_turn(submap, source, send, clock=clock))
        may_be_dropped(task)
        return await asyncio.shield(task)

    async def _take_turn(
        self,
        submap: str,
        source: OccupancyGrid | VectorMap,
        send: Callable[[str, VectorMap], Awaitable[bool]],
        *,
        clock: Callable[[], float],
    ) -> bool:
        async with self._turn:
            if isinstance(source, VectorMap):
                from fleetmap.merge.place import check_closed

                # The fold of every peer would leave a torn map out; what is vectorized here never is.
                await in_thread(partial(check_closed, source, path=f"submap {submap}"))
                return await send(submap, source)
            vector_map = await in_thread(partial(self._vectorize, submap, source))
            sent = await send(submap, vector_map)
            sizes = await in_thread(partial(self._sizes, submap, source)) if self._baselines else {}
            self._ledger.published(
                clock(),
                {name: size for name, size in sizes.items() if size is not None},
                missing=[name for name, size in sizes.items() if size is None],
            )
            return sent

    def _vectorize(self, submap: str, grid: OccupancyGrid) -> VectorMap:
        from fleetmap.vectorize import Vectorizer

        before, vectorizer = self._vectorizers.get(submap), Vectorizer()
        if before is not None:
            try:
                return before.update(grid)
            except ConfigError:  # another resolution or rotation: the submap starts anew on another lattice
                vectorizer.warned = before.warned  # a submap is warned of once
        self._vectorizers[submap] = vectorizer
        return vectorizer.update(grid)

    def _sizes(self, submap: str, grid: OccupancyGrid) -> dict[str, int | None]:
        """Bytes by baseline; None where it failed: the map has been sent, and no figure is a reason to fail."""
        from fleetmap.codecs.baselines import exact_changed_rectangle, gzip_changed_rectangle, gzip_grid

        before = self._last.get(submap)
        self._last[submap] = grid
        free = int(np.count_nonzero(grid.states_yx() == FREE))
        self._ledger.explored(submap, free * grid.resolution_m**2)
        baselines: dict[str, Callable[[], int]] = {
            "grid_gzip_full": lambda: gzip_grid(grid),
            "grid_gzip_updates": lambda: gzip_changed_rectangle(before, grid),
            "grid_exact_updates": lambda: exact_changed_rectangle(before, grid),
        }
        return {name: self._size(name, count) for name, count in baselines.items()}

    def _size(self, name: str, count: Callable[[], int]) -> int | None:
        try:
            return count()
        except Exception as error:  # whatever a codec has against a grid
            if name not in self._told:
                self._told.add(name)
                logger.warning("%s: baseline %s is not counted: %s", self._robot, name, error)
            return None
