"""An existing asyncio agent joins a fleet: it shares its own map, if it has one, and holds everybody's.

Try it beside a simulated fleet:   fleetmap sim --hold-s 30
then:                              python examples/embed_async.py [--map map.yaml]

The simulation prints its fleet and endpoint: give them with --fleet and --connect if they are not the usual ones.
"""

import argparse
import asyncio

import fleetmap


async def main(robot: str, fleet: str, connect: str, map_yaml: str | None) -> None:
    """Join, publish, look at the fleet's map, leave."""
    # The agent's map frame is the fleet's here; T_fleet_robot of a real robot goes into ``start``.
    start = fleetmap.Pose2(0.0, 0.0, 0.0)
    async with fleetmap.join(robot, fleet=fleet, start=start, connect=[connect], profile="local") as peer:
        if map_yaml is not None:
            await peer.publish(fleetmap.load_map(map_yaml))  # in an agent: whenever its SLAM has a new grid
        merged = await peer.synced(timeout_s=10.0, at_least=1)
        print("robots:", ", ".join(f"{p.robot} ({'alive' if p.alive else 'absent'})" for p in peer.peers))
        print(f"merged map: {len(merged)} edges, {merged.to_grid().width} x {merged.to_grid().height} cells")
        print("digest:", merged.digest)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="guest")
    parser.add_argument("--fleet", default="sim")
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447")
    parser.add_argument("--map", help="a map_server map in the fleet's frame, to share")
    options = parser.parse_args()
    asyncio.run(main(options.robot, options.fleet, options.connect, options.map))
