"""Network namespaces: what passes is counted by the kernel, and may be slow. Nothing outside of them is touched."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self

from fleetmap.accounting.wire import TCP_IP_BYTES

INSIDE = "--inside"


def counted_bytes() -> int:
    """IP bytes that this namespace has sent so far, to itself or to others."""

    def table(path: str, name: str) -> dict[str, int]:
        names, values = (line.split()[1:] for line in Path(path).read_text().splitlines() if line.startswith(name))
        return dict(zip(names, map(int, values), strict=True))

    ip, tcp = table("/proc/self/net/snmp", "Ip:"), table("/proc/self/net/snmp", "Tcp:")
    octets = table("/proc/self/net/netstat", "IpExt:")["OutOctets"]
    # What is to be cut into segments is counted as one packet.
    return octets + (tcp["OutSegs"] + tcp["OutRsts"] - ip["OutRequests"]) * TCP_IP_BYTES


def in_a_namespace(script: str) -> int:
    """Run a script again, with ``--inside``, where nothing else is; 0 with a reason where that can't be."""
    if shutil.which("unshare") is None or shutil.which("ip") is None:
        sys.stdout.write("skipped: unshare and ip are not installed\n")
        return 0
    make = ["unshare", "--user", "--map-root-user", "--net"]
    tried = subprocess.run([*make, "ip", "link", "set", "lo", "up"], capture_output=True, text=True, check=False)
    if tried.returncode != 0:
        sys.stdout.write(f"skipped: no right to make a network namespace ({tried.stderr.strip()})\n")
        return 0
    shell = 'ip link set lo mtu 1500 && ip link set lo up && exec "$0" "$@"'
    again = [sys.executable, script, INSIDE, *sys.argv[1:]]
    return subprocess.run([*make, "sh", "-c", shell, *again], check=False).returncode


class Air:
    """A bridge in this namespace, and hosts beside it, each in one of its own; use it as ``with``.

    Host k has the address 10.77.0.k.
    """

    def __init__(self) -> None:
        self._hosts: dict[int, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Self:
        _do("ip link add air type bridge")
        _do("ip link set air up")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for k, host in self._hosts.items():
            _do(f"ip link del air{k}")  # the kernel takes its time over what is in a namespace that ends
            host.kill()
            host.wait()
        _do("ip link del air")

    def host(self, k: int, *, bits_a_second: int | None = None) -> None:
        """Put up a host, behind a link of so much each way."""
        holder = subprocess.Popen(["unshare", "--net", "sh", "-c", "echo; exec sleep infinity"], stdout=subprocess.PIPE)
        assert holder.stdout is not None
        holder.stdout.readline()
        self._hosts[k] = holder
        _do(f"ip link add air{k} type veth peer name air netns {holder.pid}")
        _do(f"ip link set air{k} master air up")
        inside = f"nsenter --target {holder.pid} --net "
        for command in (f"ip addr add 10.77.0.{k}/24 dev air", "ip link set air up", "ip link set lo up"):
            _do(inside + command)
        if bits_a_second is not None:
            slow = f"root tbf rate {bits_a_second}bit burst 1600 limit 60000"
            _do(f"tc qdisc add dev air{k} {slow}")
            _do(f"{inside}tc qdisc add dev air {slow}")

    def cut(self, k: int, *, up: bool = False) -> None:
        """Part a host from all others; ``up``: undo it."""
        _do(f"ip link set air{k} {'up' if up else 'down'}")

    def part(self, a: int, b: int) -> None:
        """Let nothing pass between two hosts, though both reach the others."""
        for one, other in ((a, b), (b, a)):
            _do(f"nsenter --target {self._hosts[one].pid} --net ip route add blackhole 10.77.0.{other}/32")

    def start(self, k: int, command: Sequence[str]) -> subprocess.Popen[str]:
        """A process on a host, with pipes."""
        inside = ["nsenter", "--target", str(self._hosts[k].pid), "--net"]
        return subprocess.Popen([*inside, *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def _do(command: str) -> None:
    subprocess.run(command.split(), check=True)
