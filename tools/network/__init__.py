"""Agents on a real network: certificates of a team, one agent as a process, a whole team on this machine."""
