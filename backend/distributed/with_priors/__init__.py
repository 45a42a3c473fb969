"""Priors (GPS among them) in methods that know edges only: where their frame lies is agreed on, then they are held."""
