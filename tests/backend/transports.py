"""A transport that misbehaves by a seeded schedule: messages are lost, repeated, late and out of order."""

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
