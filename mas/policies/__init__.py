"""Whom to ask, to optimise with and to trade with; presets."""
