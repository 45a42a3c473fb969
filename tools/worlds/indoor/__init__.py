"""An office floor: rooms, furniture, and the walks through it."""
