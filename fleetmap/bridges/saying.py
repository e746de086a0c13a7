"""``Saying``: what the bridge offers to ROS: the fleet's map, its frame, teammates, and what is wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fleetmap.bridges import cdr, grids, said
from fleetmap.bridges.options import BridgeOptions
from fleetmap.bridges.port import Port, Say
from fleetmap.bridges.qos import LATCHED, LATEST, STREAM, Qos
from fleetmap.model.errors import MapFormatError
from fleetmap.model.grid import OccupancyGrid
from fleetmap.model.mergedmap import MergedMap
from fleetmap.model.pose import Pose2
from fleetmap.peer import TeammateInfo
from fleetmap.peer.health import Problem


class Saying:
    """The publishers of a bridge.

    Parameters
    ----------
    port : the node in the ROS graph, not yet open
    options : topics and frames

    Attributes
    ----------
    maps_out : fleet maps that went
    undrawn : why the last one couldn't be drawn as a grid; empty if it could
    """

    def __init__(self, port: Port, options: BridgeOptions) -> None:
        self._port, self._options = port, options
        self._before: OccupancyGrid | None = None
        self._says: dict[str, Say] = {}
        self.maps_out, self.undrawn = 0, ""
        self._offer(options.fleet_map_topic, cdr.MAP, LATCHED)
        if options.fleet_map_updates:
            self._offer(self._updates_topic, cdr.MAP_UPDATE, Qos(depth=10))
        self._offer(options.markers_topic, cdr.MARKERS, LATCHED)
        self._offer(options.teammates_topic, cdr.POSES, LATEST)
        self._offer(self._names_topic, cdr.MARKERS, LATEST)
        self._offer(options.diagnostics_topic, cdr.DIAGNOSTICS, Qos(depth=10))
        if options.publish_tf:
            self._offer(options.tf_topic, cdr.TF, STREAM)

    def fleet_map(self, merged: MergedMap, frame: str) -> None:
        """The merged map: its walls, and drawn, whole and if asked for what changed."""
        options, stamp_ns = self._options, self._port.now_ns()
        if options.markers_topic:
            walls = said.walls(merged, frame_id=frame, stamp_ns=stamp_ns)
            self._says[options.markers_topic](cdr.encode(walls, cdr.MARKERS))
        try:
            grid = merged.to_grid(options.resolution_m or None)
            self.undrawn = ""
        except MapFormatError as error:  # too many cells: a teammate is kilometres away
            self.undrawn = str(error)
            return
        if options.fleet_map_updates:
            self._say_update(grid, frame, stamp_ns)
        message = grids.map_message(grid, frame_id=frame, stamp_ns=stamp_ns)
        self._says[options.fleet_map_topic](cdr.encode(message, cdr.MAP))
        self.maps_out += 1

    def frame(self, T_fleet_map: Pose2, map_frame: str) -> None:
        """Where the own map lies in the fleet's frame."""
        stamp_ns = self._port.now_ns()
        if stamp_ns:
            parent = self._options.fleet_frame
            message = said.transform(T_fleet_map, parent=parent, child=map_frame, stamp_ns=stamp_ns)
            self._says[self._options.tf_topic](cdr.encode(message, cdr.TF))

    def teammates(self, mates: Sequence[TeammateInfo]) -> None:
        """Where the others are, and what they are called."""
        if self._options.teammates_topic:
            frame, stamp_ns = self._options.fleet_frame, self._port.now_ns()
            poses = said.poses(mates, frame_id=frame, stamp_ns=stamp_ns)
            self._says[self._options.teammates_topic](cdr.encode(poses, cdr.POSES))
            names = said.names(mates, frame_id=frame, stamp_ns=stamp_ns)
            self._says[self._names_topic](cdr.encode(names, cdr.MARKERS))

    def status(self, robot: str, fleet: str, problems: Sequence[Problem], figures: Mapping[str, object]) -> None:
        """What is wrong, and what was done."""
        if self._options.diagnostics_topic:
            message = said.diagnostics(robot, fleet, problems, figures, stamp_ns=self._port.now_ns())
            self._says[self._options.diagnostics_topic](cdr.encode(message, cdr.DIAGNOSTICS))

    @property
    def _updates_topic(self) -> str:
        return f"{self._options.fleet_map_topic}_updates"

    @property
    def _names_topic(self) -> str:
        topic = self._options.teammates_topic
        return f"{topic}_names" if topic else ""

    def _offer(self, topic: str, type_name: str, qos: Qos) -> None:
        if topic:
            self._says[topic] = self._port.advertise(topic, type_name, qos)

    def _say_update(self, grid: OccupancyGrid, frame: str, stamp_ns: int) -> None:
        before, self._before = self._before, grid
        if before is not None:
            update = grids.update_message(before, grid, frame_id=frame, stamp_ns=stamp_ns)
            if update is not None:
                self._says[self._updates_topic](cdr.encode(update, cdr.MAP_UPDATE))
