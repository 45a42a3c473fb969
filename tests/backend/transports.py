"""Transports for groups of nodes, in order or by a seeded schedule: messages are lost, repeated, late, out of order."""

from __future__ import annotations

from maslam.backend.distributed.methods import node_for
from maslam.backend.distributed.wire import pack, unpack


def faulty(group, config, rng, loss=0.3, repeat=0.2, latest=4, most=5000):
    """Run one node a share; all tick once a unit of time, a message takes 1 to ``latest``. Returns the outcomes."""
    nodes = {robot: node_for(share, config) for robot, share in sorted(group.items())}
    flying = []

    def post(now, messages):
        for data in ((m.sender, m.receiver, pack(m)) for m in messages):
            for _ in range(1 + (rng.random() < repeat)):
                if rng.random() >= loss:
                    flying.append((now + 1 + int(rng.integers(latest)), data))

    for node in nodes.values():
        post(0, node.start())
    for now in range(1, most):
        due = [data for at, data in flying if at <= now]
        flying[:] = [(at, data) for at, data in flying if at > now]
        for k in rng.permutation(len(due)):
            message = unpack(*due[k])
            post(now, nodes[message.receiver].handle(message))
        for robot in rng.permutation(sorted(nodes)):
            post(now, nodes[robot].tick())
        if all(node.outcome is not None for node in nodes.values()):
            return {robot: node.outcome for robot, node in nodes.items()}
    raise AssertionError(f"not all ended in {most} units of time")


def carried(nodes, messages, done, rng=None, loss=0.0, repeat=0.0, ticks=2000):
    """Carry messages among nodes, which tick when none is on its way, until ``done()``; returns all that arrived.

    In order, or with ``rng`` in any order, lost and repeated by these shares. Robots that are not among the nodes
    receive and send nothing.
    """
    queue, seen = [(m.sender, m.receiver, pack(m)) for m in messages], []
    for _ in range(ticks):
        while queue:
            sent = queue.pop(int(rng.integers(len(queue))) if rng else 0)
            if rng and rng.random() < loss:
                continue
            if rng and rng.random() < repeat:
                queue.append(sent)
            message = unpack(*sent)
            if message.receiver in nodes:
                seen.append(message)
                queue += [(m.sender, m.receiver, pack(m)) for m in nodes[message.receiver].handle(message)]
        if done():
            return seen
        queue = [(m.sender, m.receiver, pack(m)) for node in nodes.values() for m in node.tick()]
    raise AssertionError("somebody waits for ever")


def until_ended(nodes, dead=(), rng=None, loss=0.0, repeat=0.0):
    """Run solver nodes until all living ones have ended; ``dead`` robots receive and send nothing."""
    alive = {r: n for r, n in nodes.items() if r not in dead}
    first = [m for n in alive.values() for m in n.start()]
    return carried(alive, first, lambda: all(n.outcome for n in alive.values()), rng, loss, repeat)
