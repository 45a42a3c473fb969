"""Agents: contract net, policies, place recognition between agents, transports, metrics, the simulation."""
