"""Maps as goods: what they hold, how they are coded, checked and laid together (thesis sections 3.7, 3.9.3)."""
