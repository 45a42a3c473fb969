"""Policies: which agents to ask, to optimise with and to buy maps from; presets."""
