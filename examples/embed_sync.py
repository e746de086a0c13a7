"""An existing agent without asyncio joins a fleet: the same calls, each of them blocking.

Try it beside a simulated fleet:   fleetmap sim --hold-s 30
then:                              python examples/embed_sync.py [--map map.yaml]

The simulation prints its fleet and endpoint: give them with --fleet and --connect if they are not the usual ones.
"""

import argparse

import fleetmap
import fleetmap.sync


def main(robot: str, fleet: str, connect: str, map_yaml: str | None) -> None:
    """Join, publish, plan a path on everybody's map, leave."""
    start = fleetmap.Pose2(0.0, 0.0, 0.0)
    with fleetmap.sync.join(robot, fleet=fleet, start=start, connect=[connect], profile="local") as peer:
        if map_yaml is not None:
            peer.publish(fleetmap.load_map(map_yaml))
        merged = peer.synced(timeout_s=10.0, at_least=1)
        print("digest:", merged.digest)
        x0, y0, x1, y1 = merged.bounds_m()
        try:
            path = peer.plan((x0 + 1.0, y0 + 1.0), (x1 - 1.0, y1 - 1.0), radius_m=0.2)
            print(f"corner to corner: {path.length_m:.1f} m, {path.clearance_m:.2f} m from the map's walls at least")
        except fleetmap.NoPath as error:
            print(f"corner to corner: {error.status}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="guest")
    parser.add_argument("--fleet", default="sim")
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447")
    parser.add_argument("--map", help="a map_server map in the fleet's frame, to share")
    options = parser.parse_args()
    main(options.robot, options.fleet, options.connect, options.map)
